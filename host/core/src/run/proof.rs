//! Proofs that a configuration fits its car, by its hash.

use serde::{Deserialize, Serialize};

use crate::config::{Config, ConfigError};

/// A hash as a text of 16 hexadecimal digits.
pub(crate) mod hexadecimal {
    use serde::{Deserialize as _, Deserializer, Serializer, de::Error as _};

    #[allow(clippy::trivially_copy_pass_by_ref, reason = "serde asks for it")]
    pub(crate) fn serialize<S: Serializer>(value: &u64, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(&format_args!("{value:016x}"))
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u64, D::Error> {
        let text = String::deserialize(deserializer)?;
        u64::from_str_radix(&text, 16)
            .ok()
            .filter(|_| text.len() == 16)
            .ok_or_else(|| D::Error::custom(format!("{text:?} is not 16 hexadecimal digits")))
    }
}

/// A configuration on a car. Once the first metre has shown no contradiction, it is proved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Proof {
    /// The hash of what the first metre proves: [`configuration_hash`].
    #[serde(with = "hexadecimal")]
    pub configuration: u64,
    /// The number of the car, from its board; 0 for a board without one.
    pub car_id: u16,
}

/// The most proved configurations that the control loop remembers. Of more, the oldest are
/// forgotten: they are proved again.
pub const MAX_PROOFS: usize = 64;

/// The proved configurations, the oldest first.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Proofs(heapless::Vec<Proof, MAX_PROOFS>);

impl Proofs {
    /// The last [`MAX_PROOFS`] of these.
    pub fn of(proofs: &[Proof]) -> Self {
        let mut known = Self::default();
        for &proof in proofs {
            known.insert(proof);
        }
        known
    }

    /// Whether it is proved.
    pub fn contains(&self, proof: Proof) -> bool {
        self.0.contains(&proof)
    }

    /// Adds a proof. It allocates nothing.
    pub fn insert(&mut self, proof: Proof) {
        if self.contains(proof) {
            return;
        }
        if self.0.is_full() {
            self.0.remove(0);
        }
        let _ = self.0.push(proof);
    }

    /// Forgets a proof. Returns whether there was one.
    pub fn remove(&mut self, proof: Proof) -> bool {
        let count = self.0.len();
        self.0.retain(|other| *other != proof);
        self.0.len() < count
    }
}

/// The hash of the parts of a configuration that the first metre of a drive proves: the
/// vehicle, the rigid body and how it is read, what the board is given, what the steering makes
/// of it, and how the car brakes.
/// Another reference, another limit or another geofence needs no other proof.
///
/// # Errors
///
/// A text that TOML can't represent.
pub fn configuration_hash(config: &Config) -> Result<u64, ConfigError> {
    let body = &config.motion_capture;
    let text = |result: Result<String, toml::ser::Error>| {
        result.map_err(|error| ConfigError::value("board", "not TOML", error.to_string()))
    };
    let mut hash = Fnv::default();
    hash.add(text(toml::to_string(&config.vehicle))?.as_bytes());
    hash.add(text(toml::to_string(&config.board))?.as_bytes());
    hash.add(body.rigid_body.as_bytes());
    hash.add(text(toml::Value::try_from(body.up_axis).map(|axis| axis.to_string()))?.as_bytes());
    let [forward, left] = body.marker_offset_m;
    let braking = config.fence.braking_m_s2;
    for number in [forward, left, body.marker_yaw_rad, braking] {
        hash.add(&number.to_bits().to_le_bytes());
    }
    for number in config.actuators.steering_table.iter().flatten().flatten() {
        hash.add(&number.to_bits().to_le_bytes());
    }
    let offset_ms = body.timing.stamp_offset_ms;
    if offset_ms != 0.0 {
        hash.add(&offset_ms.to_bits().to_le_bytes());
    }
    Ok(hash.0)
}

/// FNV-1a with 64 bits: the same on every machine and in every release.
pub(crate) struct Fnv(pub(crate) u64);

impl Default for Fnv {
    fn default() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }
}

impl Fnv {
    pub(crate) fn add(&mut self, bytes: &[u8]) {
        // The length keeps the parts apart.
        for byte in (bytes.len() as u64).to_le_bytes().iter().chain(bytes) {
            self.0 = (self.0 ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> Config {
        Config::from_toml(include_str!("../../../daemon/singletrackd.example.toml")).unwrap()
    }

    #[test]
    fn what_the_first_metre_proves_changes_the_hash_and_nothing_else_does() {
        let hash = |change: fn(&mut Config)| {
            let mut config = example();
            change(&mut config);
            configuration_hash(&config).unwrap()
        };
        let same = hash(|_| {});
        assert_eq!(same, hash(|_| {}));
        assert_eq!(same, hash(|config| config.limits.max_speed_m_s = 1.0));
        assert_eq!(same, hash(|config| config.supervisor.hold_ms = 200));
        assert_eq!(same, hash(|config| config.fence.margin_m = Some(0.3)));
        assert_eq!(
            same,
            hash(|config| config.fence.corners_m[0] = [-2.0, -2.0])
        );
        let changes: [fn(&mut Config); 9] = [
            |config| config.motion_capture.timing.stamp_offset_ms = -3.0,
            |config| config.fence.braking_m_s2 = 0.8,
            |config| config.board.servo.gain_us_per_rad = 801,
            |config| {
                let pairs = vec![[1_080.0, 0.5], [1_500.0, 0.0], [1_920.0, -0.5]];
                config.actuators.steering_table = Some(pairs);
            },
            |config| config.board.car_id = 7,
            |config| config.vehicle.mass_kg = 2.0,
            |config| config.motion_capture.marker_yaw_rad = 0.1,
            |config| config.motion_capture.marker_offset_m = [0.0, 0.01],
            |config| config.motion_capture.rigid_body = "other".to_owned(),
        ];
        for (index, change) in changes.into_iter().enumerate() {
            assert_ne!(same, hash(change), "{index}");
        }
    }

    #[test]
    fn the_oldest_of_too_many_proofs_is_forgotten() {
        let proof = |car_id| Proof {
            configuration: 1,
            car_id,
        };
        let many: Vec<Proof> = (0..=MAX_PROOFS as u16).map(proof).collect();
        let mut known = Proofs::of(&many);
        assert!(!known.contains(proof(0)) && known.contains(proof(1)));
        known.insert(proof(1));
        assert!(known.contains(proof(2)));
    }

    #[test]
    fn a_removed_proof_counts_no_more_and_the_others_do() {
        let proof = |configuration, car_id| Proof {
            configuration,
            car_id,
        };
        let mut known = Proofs::of(&[proof(1, 1), proof(1, 2), proof(2, 1)]);
        assert!(known.remove(proof(1, 1)));
        assert_eq!(known, Proofs::of(&[proof(1, 2), proof(2, 1)]));
        assert!(!known.remove(proof(1, 1)));
        known.insert(proof(1, 1));
        assert!(known.contains(proof(1, 1)));
    }
}
