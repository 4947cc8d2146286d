//! The node: its name, its qualities of service, the threads on which it works, and its sockets, which are
//! closed to other computers unless `--interface` is given.
//!
//! The library's sockets take datagrams on every interface, whatever it announces. A filter in
//! the kernel drops those that do not come from this computer.

use std::{
    fs, io,
    net::{IpAddr, Ipv4Addr},
    os::fd::OwnedFd,
    thread,
};

use futures::executor::block_on;
use ros2_client::{
    Context, MessageTypeName, Name, NodeName, NodeOptions, Publisher, QosProfile, Server,
    ServiceMapping, ServiceTypeName, Subscription,
    qos::{Durability, History, Reliability, WhenFull},
};
use rustdds::DomainParticipantBuilder;
use rustix::process::{PidfdFlags, PidfdGetfdFlags, getpid, pidfd_getfd, pidfd_open};
use serde::{Serialize, de::DeserializeOwned};
use socket2::{Domain, SockFilter, SockRef, Type};

use crate::{
    message::{TriggerRequest, TriggerResponse},
    shared::Arguments,
};

const NODE: &str = "singletrack";

/// Messages that are kept for a reliable subscriber: a second of the fastest topic.
const KEPT: usize = 100;

/// The node of this car.
pub(crate) struct Node {
    node: ros2_client::Node,
    namespace: String,
    pub(crate) domain: u16,
}

impl Node {
    pub(crate) fn start(arguments: &Arguments) -> Result<Self, String> {
        let environment = std::env::var("ROS_DOMAIN_ID").ok();
        let domain = arguments.domain(environment.as_deref())?;
        let namespace = &arguments.namespace;
        let name = NodeName::new(namespace, NODE)
            .map_err(|error| format!("--namespace {namespace}: {error}"))?;
        // Loopback, and the interfaces that are given.
        let networks = [&[IpAddr::from(Ipv4Addr::LOCALHOST)], &*arguments.interface].concat();
        let participant = DomainParticipantBuilder::new(domain)
            .with_only_networks(networks)
            .build()
            .map_err(network)?;
        if arguments.interface.is_empty() {
            close_to_others().map_err(|error| {
                format!(
                    "can't close the sockets to other computers: {error}; give the addresses of \
                     its interfaces with --interface to open them"
                )
            })?;
        } else {
            tracing::warn!(
                interfaces = ?arguments.interface,
                "other computers can reach this node, and there is no authentication"
            );
        }
        let context = Context::from_domain_participant(participant).map_err(network)?;
        let options = NodeOptions::new()
            // The topic has the record's log.
            .enable_rosout(false)
            // There are none.
            .start_parameter_services(false);
        let node = context.new_node(name, options).map_err(network)?;
        Ok(Self {
            node,
            namespace: namespace.clone(),
            domain,
        })
    }

    pub(crate) fn publisher<M: Serialize>(
        &mut self,
        topic: &str,
        kind: (&str, &str),
        qos: QosProfile,
    ) -> Result<Publisher<M>, String> {
        let topic = self.topic(topic, kind, &qos)?;
        let publisher = self.node.create_publisher(&topic, Some(qos));
        publisher.map_err(network)
    }

    /// A subscription to the newest message.
    pub(crate) fn subscription<M: DeserializeOwned + 'static>(
        &mut self,
        topic: &str,
        kind: (&str, &str),
        reliability: Reliability,
    ) -> Result<Subscription<M>, String> {
        let qos = qos(reliability, 1);
        let topic = self.topic(topic, kind, &qos)?;
        let subscription = self.node.create_subscription(&topic, Some(qos));
        subscription.map_err(network)
    }

    pub(crate) fn trigger(
        &mut self,
        service: &str,
    ) -> Result<Server<TriggerRequest, TriggerResponse>, String> {
        let when_full = WhenFull::DEFAULT;
        let qos = qos(Reliability::Reliable { when_full }, 10);
        let name = self.name(service)?;
        let (mapping, other) = (ServiceMapping::Enhanced, qos.clone());
        let kind = ServiceTypeName::new("std_srvs", "Trigger");
        let server = self.node.create_server(mapping, &name, &kind, qos, other);
        server.map_err(network)
    }

    /// Takes part in discovery, on a thread of its own.
    pub(crate) fn spin(&mut self) -> Result<(), String> {
        let spinner = self.node.spinner().map_err(network)?;
        start_thread("discovery", move || {
            if let Err(error) = block_on(spinner.spin()) {
                tracing::error!(%error, "discovery has ended");
            }
        })
    }

    fn topic(
        &self,
        topic: &str,
        (package, kind): (&str, &str),
        qos: &QosProfile,
    ) -> Result<rustdds::Topic, String> {
        let name = self.name(topic)?;
        let kind = MessageTypeName::new(package, kind);
        self.node.create_topic(&name, kind, qos).map_err(network)
    }

    fn name(&self, base: &str) -> Result<Name, String> {
        // One log for all nodes.
        let (namespace, base) = match base.strip_prefix('/') {
            Some(base) => ("/", base),
            None => (self.namespace.as_str(), base),
        };
        Name::new(namespace, base).map_err(|error| format!("--namespace {namespace}: {error}"))
    }
}

/// Starts a detached thread, which ends with the process.
pub(crate) fn start_thread(name: &str, run: impl FnOnce() + Send + 'static) -> Result<(), String> {
    let started = thread::Builder::new().name(name.to_owned()).spawn(run);
    let started = started.map(drop);
    started.map_err(|error| format!("can't start: {error}"))
}

fn network(error: impl core::fmt::Display) -> String {
    format!("can't take part in the network of ROS: {error}")
}

/// The quality of service of a publisher that never waits: of a reliable subscriber that is too slow it keeps the newest
/// messages, and drops the oldest.
pub(crate) fn prompt() -> QosProfile {
    let when_full = WhenFull::Fail;
    qos(Reliability::Reliable { when_full }, KEPT)
}

/// The quality of service of a publisher whose last message later subscribers get as well.
pub(crate) fn latched() -> QosProfile {
    let when_full = WhenFull::DEFAULT;
    QosProfile {
        durability: Durability::TransientLocal,
        ..qos(Reliability::Reliable { when_full }, 1)
    }
}

fn qos(reliability: Reliability, depth: usize) -> QosProfile {
    QosProfile {
        reliability,
        durability: Durability::Volatile,
        history: History::KeepLast { depth },
        ..QosProfile::subscription_default()
    }
}

/// Drops what comes from elsewhere, on every UDP socket of this process.
fn close_to_others() -> io::Result<()> {
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
