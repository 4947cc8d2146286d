//! Asks the network which servers are there. VRPN has no such question.

use std::{
    io,
    net::{Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket},
    time::{Duration, Instant},
};

use singletrack_core::config::ServerKind;
use singletrack_mocap::{
    DEFAULT_COMMAND_PORT,
    codec::ClientMessage,
    encode,
    qualisys::packet::{DISCOVERY_PORT, discovery},
};

/// How long answers are waited for.
const ANSWERS: Duration = Duration::from_secs(1);

/// The servers that answer a question to this address, which may be that of a whole network.
pub(super) fn servers(asked: Ipv4Addr) -> io::Result<Vec<(ServerKind, Ipv4Addr)>> {
    let natnet = socket()?;
    let mut question = [0; 64];
    let length = encode::client_message(&ClientMessage::Discovery, &mut question)
        .map_err(io::Error::other)?;
    let question = question.get(..length).unwrap_or_default();
    natnet.send_to(question, SocketAddrV4::new(asked, DEFAULT_COMMAND_PORT))?;
    let qualisys = socket()?;
    let question = discovery(qualisys.local_addr()?.port());
    qualisys.send_to(&question, SocketAddrV4::new(asked, DISCOVERY_PORT))?;
    let mut found = Vec::new();
    for (kind, socket) in [
        (ServerKind::NatNet, natnet),
        (ServerKind::Qualisys, qualisys),
    ] {
        let until = Instant::now() + ANSWERS / 2;
        while Instant::now() < until {
            if let Ok((_, SocketAddr::V4(from))) = socket.recv_from(&mut [0; 2_048])
                && !found.contains(&(kind, *from.ip()))
            {
                found.push((kind, *from.ip()));
            }
        }
    }
    Ok(found)
}

fn socket() -> io::Result<UdpSocket> {
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
    socket.set_broadcast(true)?;
    socket.set_read_timeout(Some(ANSWERS / 8))?;
    Ok(socket)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use singletrack_sim::{RealTimeConfig, RealTimeSimulator, UdpConfig};

    use super::*;

    #[test]
    fn a_server_answers_with_its_kind_and_address() {
        // Their usual ports, at an address of this computer that no other test uses.
        let address = Ipv4Addr::new(127, 0, 36, 1);
        let start = |cameras, command_port| {
            RealTimeSimulator::start(RealTimeConfig {
                cameras,
                udp: UdpConfig {
                    interface: address,
                    command_port,
                    data_port: 0,
                },
                ..RealTimeConfig::default()
            })
            .unwrap()
        };
        let _natnet = start(singletrack_sim::ServerKind::NatNet, 1_510);
        let _qualisys = start(singletrack_sim::ServerKind::Qualisys, 22_223);
        let expected = [
            (ServerKind::NatNet, address),
            (ServerKind::Qualisys, address),
        ];
        assert_eq!(servers(address).unwrap(), expected);
    }
}
