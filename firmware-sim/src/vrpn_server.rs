//! The cameras' VRPN server, without sockets.

use core::net::SocketAddr;

use singletrack_mocap::vrpn::message::{
    self, COOKIE, COOKIE_BEGINNING, Message, PING, PONG, POSE, Pose, SENDER_DESCRIPTION,
    TYPE_DESCRIPTION, UDP_DESCRIPTION,
};

use crate::{
    cameras::{CameraFrame, CameraParameters},
    sockets::{Client, Refused, StreamServer},
};

/// The server's own numbers of its types. Those of its senders are the places of the bodies.
const POSE_TYPE: i32 = 0;
const PING_TYPE: i32 = 1;
const PONG_TYPE: i32 = 2;

/// The server side of VRPN: each rigid body is a tracker with sensor 0.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct VrpnServer;

/// What is known of a client.
#[derive(Clone, Debug, Default)]
pub(crate) struct VrpnClient {
    welcomed: bool,
    /// The client's number of pings, and of the senders that are trackers here: as in VRPN's own
    /// server, only these answer.
    ping: Option<i32>,
    senders: Vec<i32>,
    sequence: u32,
}

impl VrpnClient {
    fn say(&mut self, stamp_us: u64, sender: i32, kind: i32, body: &[u8]) -> Vec<u8> {
        let mut bytes = Vec::new();
        let message = Message {
            stamp_us,
            sender,
            kind,
            body,
        };
        message.write(self.sequence, &mut |part| bytes.extend_from_slice(part));
        self.sequence = self.sequence.wrapping_add(1);
        bytes
    }
}

impl StreamServer for VrpnServer {
    type State = VrpnClient;

    fn greeting(&self, client: &Client<VrpnClient>) -> Vec<u8> {
        // A server that calls back speaks first.
        let cookie = client.was_called.then(|| COOKIE.to_vec());
        cookie.unwrap_or_default()
    }

    fn receive(
        &self,
        clock_us: u64,
        cameras: &CameraParameters,
        client: &mut Client<VrpnClient>,
        input: &[u8],
    ) -> Result<Option<usize>, Refused> {
        let state = &mut client.state;
        Ok(Some(if state.welcomed {
            let Some((message, length)) = Message::read(input).map_err(|_| Refused)? else {
                return Ok(None);
            };
            match message.kind {
                TYPE_DESCRIPTION if message.described() == Some(PING.as_bytes()) => {
                    state.ping = Some(message.sender);
                }
                UDP_DESCRIPTION => {
                    let port = u16::try_from(message.sender).ok();
                    let to = |port| SocketAddr::new(client.address, port);
                    client.datagrams_to = port.map(to);
                }
                SENDER_DESCRIPTION if state.senders.len() < 100 => {
                    let described = message.described();
                    let mut names = cameras.names().map(|(_, name)| Some(name.as_bytes()));
                    if names.any(|name| name == described) {
                        state.senders.push(message.sender);
                    }
                }
                kind if Some(kind) == state.ping && state.senders.contains(&message.sender) => {
                    let pong = state.say(clock_us, 0, PONG_TYPE, &[]);
                    client.output.extend(pong);
                }
                _ => {}
            }
            length
        } else {
            let seen = input.len().min(COOKIE_BEGINNING.len());
            if input.get(..seen) != COOKIE_BEGINNING.get(..seen) {
                return Err(Refused);
            }
            if input.len() < COOKIE.len() {
                return Ok(None);
            }
            state.welcomed = true;
            if !client.was_called {
                client.output.extend(COOKIE);
            }
            let descriptions = [
                (POSE_TYPE, TYPE_DESCRIPTION, POSE),
                (PING_TYPE, TYPE_DESCRIPTION, PING),
                (PONG_TYPE, TYPE_DESCRIPTION, PONG),
            ];
            let senders = (0..)
                .zip(cameras.names())
                .map(|(number, (_, name))| (number, SENDER_DESCRIPTION, name));
            for (number, kind, name) in descriptions.into_iter().chain(senders) {
                let said = state.say(clock_us, number, kind, &message::description(name));
                client.output.extend(said);
            }
            COOKIE.len()
        }))
    }

    fn frame(
        &self,
        cameras: &CameraParameters,
        frame: &CameraFrame,
        stamp_us: u64,
        client: &mut Client<VrpnClient>,
    ) -> Vec<u8> {
        let mut bytes = Vec::new();
        if !client.state.welcomed {
            return bytes;
        }
        for (number, (id, _)) in (0..).zip(cameras.names()) {
            // VRPN has no sign of a body that is not seen: nothing is reported.
            if let Some(body) = frame.tracked(id) {
                let pose = Pose {
                    sensor: 0,
                    position_m: body.position_m.map(f64::from),
                    orientation_xyzw: body.orientation_xyzw.map(f64::from),
                };
                bytes.extend(client.state.say(stamp_us, number, POSE_TYPE, &pose.body()));
            }
        }
        bytes
    }
}
