//! Closes the sockets of DDS to other computers.
//!
//! The library's sockets take datagrams on every interface, whatever it announces. A filter in
//! the kernel drops those that do not come from this computer.

use std::{
    fs, io,
    net::{IpAddr, Ipv4Addr},
    os::fd::OwnedFd,
};

use rustix::process::{PidfdFlags, PidfdGetfdFlags, getpid, pidfd_getfd, pidfd_open};
use socket2::{Domain, SockFilter, SockRef, Type};

/// The addresses of the interfaces that are used: that of loopback if none is given.
pub(crate) fn networks(interfaces: &[IpAddr]) -> Vec<IpAddr> {
    [&[IpAddr::from(Ipv4Addr::LOCALHOST)], interfaces].concat()
}

/// Drops what comes from elsewhere, on every UDP socket of this process.
pub(crate) fn close_to_others() -> io::Result<()> {
    let process = pidfd_open(getpid(), PidfdFlags::empty())?;
    let mut closed = 0;
    for entry in fs::read_dir("/proc/self/fd")? {
        let name = entry?.file_name();
        let Some(number) = name.to_str().and_then(|name| name.parse().ok()) else {
            continue;
        };
        // The list's own descriptor has been closed.
        let Ok(file) = pidfd_getfd(&process, number, PidfdGetfdFlags::empty()) else {
            continue;
        };
        match datagrams(&file) {
            Some(Domain::IPV4) => {
                SockRef::from(&file).attach_filter(&FROM_HERE)?;
                closed += 1;
            }
            Some(Domain::IPV6) => SockRef::from(&file).attach_filter(&NOTHING)?,
            Some(_) | None => {}
        }
    }
    if closed == 0 {
        return Err(io::Error::other("it has no socket"));
    }
    Ok(())
}

/// The domain of a socket for datagrams; none if the file is something else.
fn datagrams(file: &OwnedFd) -> Option<Domain> {
    let socket = SockRef::from(file);
    let kind = socket.r#type().ok()?;
    (kind == Type::DGRAM).then(|| socket.domain().ok())?
}

/// Classic BPF: takes a datagram whose source is in 127.0.0.0/8.
const FROM_HERE: [SockFilter; 4] = [
    // Load the first byte of the source address: offset 12 of the header of the network.
    SockFilter::new(LOAD_BYTE_ABSOLUTE, 0, 0, NETWORK_HEADER + 12),
    SockFilter::new(JUMP_IF_EQUAL, 0, 1, 127),
    SockFilter::new(RETURN, 0, 0, u32::MAX),
    SockFilter::new(RETURN, 0, 0, 0),
];

/// Takes nothing: nodes of ROS reach this one over IPv4.
const NOTHING: [SockFilter; 1] = [SockFilter::new(RETURN, 0, 0, 0)];

/// `BPF_LD | BPF_B | BPF_ABS`.
const LOAD_BYTE_ABSOLUTE: u16 = 0x30;
/// `BPF_JMP | BPF_JEQ | BPF_K`.
const JUMP_IF_EQUAL: u16 = 0x15;
/// `BPF_RET | BPF_K`.
const RETURN: u16 = 0x06;
/// `SKF_NET_OFF`: offsets from here on count from the header of the network.
const NETWORK_HEADER: u32 = (-0x10_0000_i32).cast_unsigned();

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may fail")]
mod tests {
    use std::{net::UdpSocket, time::Duration};

    use super::*;

    #[test]
    fn datagrams_of_this_computer_pass_the_filter() {
        let receiver = UdpSocket::bind("0.0.0.0:0").unwrap();
        receiver
            .set_read_timeout(Some(Duration::from_secs(5)))
            .unwrap();
        close_to_others().unwrap();
        let port = receiver.local_addr().unwrap().port();
        let sender = UdpSocket::bind("127.0.0.1:0").unwrap();
        sender.send_to(b"here", ("127.0.0.1", port)).unwrap();
        let mut bytes = [0; 8];
        assert_eq!(receiver.recv(&mut bytes).unwrap(), 4);
    }
}
