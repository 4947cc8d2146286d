//! The cameras' server of the real-time protocol of Qualisys QTM, without sockets.

use core::net::SocketAddr;
use std::fmt::Write as _;

use singletrack_mocap::qualisys::packet::{
    ByteOrder, Component, FrameBody, Kind, Packet, write_frame,
};

use crate::{
    cameras::{CameraFrame, CameraParameters},
    sockets::{Client, Refused, StreamServer},
};

/// The versions that are spoken: 1.8 to this.
const NEWEST_MINOR: u32 = 25;

/// The server side of QTM's protocol.
#[derive(Clone, Copy, Debug)]
pub(crate) struct QtmServer {
    pub(crate) order: ByteOrder,
}

/// What is known of a client.
#[derive(Clone, Debug, Default)]
pub(crate) struct QtmClient {
    /// The version's number after the point; without a request for a version it is one.
    minor: Option<u32>,
    stream: Option<Streamed>,
}

/// What is streamed to a client.
#[derive(Clone, Debug)]
struct Streamed {
    components: Vec<Component>,
    /// Every such frame.
    divisor: i32,
}

impl QtmServer {
    fn packet(self, kind: Kind, body: &[u8]) -> Vec<u8> {
        let mut bytes = Vec::new();
        Packet { kind, body }.write(self.order, &mut |part| bytes.extend_from_slice(part));
        bytes
    }

    fn text(self, kind: Kind, text: &str) -> Vec<u8> {
        let mut body = text.as_bytes().to_vec();
        body.push(0);
        self.packet(kind, &body)
    }

    fn answer(
        self,
        cameras: &CameraParameters,
        client: &mut Client<QtmClient>,
        command: &str,
    ) -> Vec<u8> {
        let lower = command.to_lowercase();
        let mut words = lower.split_whitespace();
        let ok = |text: &str| self.text(Kind::Command, text);
        let refused = |text: &str| self.text(Kind::Error, text);
        match words.next() {
            Some("version") => {
                let wanted = words.next().and_then(|version| version.strip_prefix("1."));
                match wanted.and_then(|minor| minor.parse().ok()) {
                    Some(minor) if (8..=NEWEST_MINOR).contains(&minor) => {
                        client.state.minor = Some(minor);
                        ok(&format!("Version set to 1.{minor}"))
                    }
                    _ => refused("Version NOT supported"),
                }
            }
            Some("qtmversion") => ok("QTM Version is 2.17 (build 4000)"),
            Some("byteorder") => ok(match self.order {
                ByteOrder::Little => "Byte order is little endian",
                ByteOrder::Big => "Byte order is big endian",
            }),
            // The event "connected".
            Some("getstate") => self.packet(Kind::Event, &[1]),
            Some("getparameters") => {
                let with_bodies = words.any(|word| matches!(word, "6d" | "all"));
                let xml = parameters(client.state.minor.unwrap_or(1), cameras, with_bodies);
                self.text(Kind::Xml, &xml)
            }
            Some("streamframes") => {
                let rest: Vec<_> = words.collect();
                if rest.first() == Some(&"stop") {
                    client.state.stream = None;
                    return Vec::new();
                }
                let mut words = rest.iter();
                let to = words.find_map(|word| word.strip_prefix("udp:"));
                client.datagrams_to = to.and_then(|to| datagrams_to(client, to));
                let divisor = |word: &&str| word.strip_prefix("frequencydivisor:")?.parse().ok();
                let divisor = rest.iter().find_map(divisor);
                let mut components = Vec::new();
                for component in rest.iter().filter_map(|word| component(word)) {
                    if !components.contains(&component) {
                        components.push(component);
                    }
                }
                client.state.stream = Some(Streamed {
                    components,
                    divisor: divisor.unwrap_or(1).max(1),
                });
                Vec::new()
            }
            _ => refused("Command not supported"),
        }
    }
}

/// A component that this server has; it leaves out the others.
fn component(word: &str) -> Option<Component> {
    match word {
        "6d" => Some(Component::Bodies),
        "6dres" => Some(Component::WithResiduals),
        "6deuler" => Some(Component::EulerAngles),
        _ => None,
    }
}

/// Where datagrams go: a port at the client's address, or an address and a port.
fn datagrams_to(client: &Client<QtmClient>, to: &str) -> Option<SocketAddr> {
    match to.rsplit_once(':') {
        Some((address, port)) => Some(SocketAddr::new(address.parse().ok()?, port.parse().ok()?)),
        None => Some(SocketAddr::new(client.address, to.parse().ok()?)),
    }
}

/// The settings as XML.
fn parameters(minor: u32, cameras: &CameraParameters, with_bodies: bool) -> String {
    let mut xml = format!("<QTM_Parameters_Ver_1.{minor}>");
    if with_bodies {
        // Strings take what is written.
        let _ = write!(xml, "<The_6D><Bodies>{}</Bodies>", cameras.names().count());
        for (_, name) in cameras.names() {
            let name = name.replace('&', "&amp;").replace('<', "&lt;");
            let name = name.replace('>', "&gt;");
            let colour = if minor > 20 {
                "<Enabled>true</Enabled><Color R=\"0\" G=\"128\" B=\"0\"/>"
            } else {
                "<RGBColor>32768</RGBColor>"
            };
            let _ = write!(xml, "<Body><Name>{name}</Name>{colour}</Body>");
        }
        xml.push_str(
            "<Euler><First>Roll</First><Second>Pitch</Second><Third>Yaw</Third></Euler></The_6D>",
        );
    }
    let _ = write!(xml, "</QTM_Parameters_Ver_1.{minor}>");
    xml
}

impl StreamServer for QtmServer {
    type State = QtmClient;

    fn greeting(&self, _: &Client<QtmClient>) -> Vec<u8> {
        self.text(Kind::Command, "QTM RT Interface connected")
    }

    fn receive(
        &self,
        _: u64,
        cameras: &CameraParameters,
        client: &mut Client<QtmClient>,
        input: &[u8],
    ) -> Result<Option<usize>, Refused> {
        let Some((packet, length)) = Packet::read(self.order, input).map_err(|_| Refused)? else {
            return Ok(None);
        };
        if packet.kind == Kind::Command {
            let answer = self.answer(cameras, client, packet.text().unwrap_or_default());
            client.output.extend(answer);
        }
        Ok(Some(length))
    }

    fn frame(
        &self,
        cameras: &CameraParameters,
        frame: &CameraFrame,
        stamp_us: u64,
        client: &mut Client<QtmClient>,
    ) -> Vec<u8> {
        let mut bytes = Vec::new();
        let is_due = |streamed: &&Streamed| frame.number % streamed.divisor == 0;
        let Some(streamed) = client.state.stream.as_ref().filter(is_due) else {
            return bytes;
        };
        let bodies: Vec<_> = cameras
            .names()
            .map(|(id, _)| {
                frame.tracked(id).map_or(UNSEEN, |body| FrameBody {
                    position_mm: body.position_m.map(|metres| metres * 1e3),
                    axes: axes(body.orientation_xyzw),
                    residual_mm: body.mean_error_m * 1e3,
                })
            })
            .collect();
        write_frame(
            self.order,
            stamp_us,
            frame.number.cast_unsigned(),
            &bodies,
            &streamed.components,
            &mut |part| bytes.extend_from_slice(part),
        );
        bytes
    }
}

/// A body that is not seen.
const UNSEEN: FrameBody = FrameBody {
    position_mm: [f32::NAN; 3],
    axes: [[f32::NAN; 3]; 3],
    residual_mm: f32::NAN,
};

/// The columns of the rotation matrix.
fn axes(quaternion: [f32; 4]) -> [[f32; 3]; 3] {
    let [x, y, z, w] = quaternion.map(f64::from);
    let columns = [
        [
            1.0 - 2.0 * (y * y + z * z),
            2.0 * (x * y + z * w),
            2.0 * (x * z - y * w),
        ],
        [
            2.0 * (x * y - z * w),
            1.0 - 2.0 * (x * x + z * z),
            2.0 * (y * z + x * w),
        ],
        [
            2.0 * (x * z + y * w),
            2.0 * (y * z - x * w),
            1.0 - 2.0 * (x * x + y * y),
        ],
    ];
    columns.map(|column| column.map(|value| value as f32))
}
