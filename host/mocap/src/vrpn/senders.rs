//! The senders that a server has described.

/// The longest name of a sender that VRPN allows.
pub(crate) const NAME_LEN: usize = 100;

/// How many senders are remembered.
const SENDERS: usize = 24;

/// A sender's name.
pub(crate) type Name = heapless::Vec<u8, NAME_LEN>;

/// The senders that a server has described, by their numbers.
#[derive(Clone, Debug, Default)]
pub struct Senders {
    names: heapless::Vec<(i32, Name), SENDERS>,
    sensor: i32,
}

/// The name of the connection itself, which is no tracker.
pub(super) const CONTROL: &[u8] = b"VRPN Control";

impl Senders {
    pub(super) const fn new(sensor: i32) -> Self {
        Self {
            names: heapless::Vec::new(),
            sensor,
        }
    }

    /// Takes a description. Returns whether it was news. The needed sender always has room.
    pub(super) fn describe(&mut self, number: i32, name: &[u8], needed: Option<&[u8]>) -> bool {
        let Ok(name) = Name::try_from(name) else {
            return false;
        };
        // A name belongs to one number: the newest.
        self.names
            .retain(|(known, other)| *known == number || *other != name);
        let known = self.names.iter().position(|(known, _)| *known == number);
        match known.and_then(|index| self.names.get_mut(index)) {
            Some((_, known)) if *known == name => false,
            Some((_, known)) => {
                *known = name;
                true
            }
            None => {
                if self.names.is_full() {
                    if needed != Some(name.as_slice()) {
                        return false;
                    }
                    self.names.pop();
                }
                self.names.push((number, name)).is_ok()
            }
        }
    }

    /// The name of a sender.
    pub(super) fn name(&self, number: i32) -> Option<&[u8]> {
        let mut names = self.names.iter();
        let (_, name) = names.find(|(known, _)| *known == number)?;
        Some(name)
    }

    /// The body of each sender with the configured sensor, and the sender's name.
    pub fn iter(&self) -> impl Iterator<Item = (i32, &[u8])> {
        self.names
            .iter()
            .filter(|(_, name)| name != CONTROL)
            .map(|(number, name)| (body_id(*number, self.sensor), name.as_slice()))
    }
}

/// The id of a body: the sender's number and the sensor's.
pub(crate) const fn body_id(sender: i32, sensor: i32) -> i32 {
    sender.wrapping_mul(1_000).wrapping_add(sensor)
}
