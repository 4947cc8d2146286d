//! The sockets of a server that is reached over TCP, whatever its protocol.

use std::{
    io::{ErrorKind, Read as _, Write as _},
    net::{IpAddr, SocketAddr, TcpListener, TcpStream, UdpSocket},
};

use crate::cameras::{CameraFrame, CameraParameters, TICKS_PER_SECOND};

/// The client said what its protocol does not know.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Refused;

/// What a protocol answers.
pub(crate) trait StreamServer: core::fmt::Debug {
    /// What is known of a client.
    type State: Default + core::fmt::Debug;

    /// What is said first.
    fn greeting(&self, client: &Client<Self::State>) -> Vec<u8>;

    /// Takes the first message of the input, and returns its length; none if it is not complete.
    fn receive(
        &self,
        clock_us: u64,
        cameras: &CameraParameters,
        client: &mut Client<Self::State>,
        input: &[u8],
    ) -> Result<Option<usize>, Refused>;

    /// The bytes of a frame for the client.
    fn frame(
        &self,
        cameras: &CameraParameters,
        frame: &CameraFrame,
        stamp_us: u64,
        client: &mut Client<Self::State>,
    ) -> Vec<u8>;
}

/// A client.
#[derive(Clone, Debug)]
pub(crate) struct Client<S> {
    pub(crate) state: S,
    pub(crate) address: IpAddr,
    /// The server called it back.
    pub(crate) was_called: bool,
    /// What is to be sent on the stream.
    pub(crate) output: Vec<u8>,
    /// Where frames go, if not on the stream.
    pub(crate) datagrams_to: Option<SocketAddr>,
}

/// The most clients at a time, and the most bytes that wait for one.
const MAX_CLIENTS: usize = 16;
const MAX_WAITING: usize = 1 << 20;

/// A listening protocol with its clients.
#[derive(Debug)]
pub(crate) struct Serving<P: StreamServer> {
    protocol: P,
    listener: TcpListener,
    /// With what was received of each and not used.
    clients: Vec<(TcpStream, Client<P::State>, Vec<u8>)>,
}

impl<P: StreamServer> Serving<P> {
    pub(crate) fn new(protocol: P, listener: TcpListener) -> Self {
        Self {
            protocol,
            listener,
            clients: Vec::new(),
        }
    }

    pub(crate) fn welcome(&mut self, stream: TcpStream, address: IpAddr, was_called: bool) {
        let prepared = stream
            .set_nonblocking(true)
            .and_then(|()| stream.set_nodelay(true));
        if prepared.is_err() || self.clients.len() >= MAX_CLIENTS {
            return;
        }
        let mut client = Client {
            state: P::State::default(),
            address,
            was_called,
            output: Vec::new(),
            datagrams_to: None,
        };
        client.output = self.protocol.greeting(&client);
        self.clients.push((stream, client, Vec::new()));
    }

    pub(crate) fn serve(&mut self, clock: &impl Fn() -> u64, cameras: &CameraParameters) {
        while let Ok((stream, from)) = self.listener.accept() {
            self.welcome(stream, from.ip(), false);
        }
        let protocol = &self.protocol;
        self.clients.retain_mut(|(stream, client, input)| {
            let mut used = 0;
            let is_alive = read(stream, input)
                && loop {
                    let unused = input.get(used..).unwrap_or_default();
                    match protocol.receive(clock(), cameras, client, unused) {
                        Ok(Some(length)) => used += length,
                        Ok(None) => break true,
                        Err(Refused) => break false,
                    }
                };
            input.drain(..used);
            is_alive && write(stream, &mut client.output)
        });
    }

    /// Sends a frame; returns the number of datagrams that were lost.
    pub(crate) fn frame(
        &mut self,
        cameras: &CameraParameters,
        frame: &CameraFrame,
        udp: &UdpSocket,
    ) -> u64 {
        let stamp_us = frame.ticks.mid_exposure / (TICKS_PER_SECOND / 1_000_000);
        let protocol = &self.protocol;
        let mut lost = 0;
        self.clients.retain_mut(|(stream, client, _)| {
            let bytes = protocol.frame(cameras, frame, stamp_us, client);
            if bytes.is_empty() {
                return true;
            }
            match client.datagrams_to {
                Some(to) => {
                    lost += u64::from(udp.send_to(&bytes, to).is_err());
                    true
                }
                None => {
                    client.output.extend(bytes);
                    write(stream, &mut client.output)
                }
            }
        });
        lost
    }
}

/// Reads what has arrived; false if the client has gone.
fn read(mut stream: &TcpStream, input: &mut Vec<u8>) -> bool {
    let mut buffer = [0; 4_096];
    while input.len() < MAX_WAITING {
        match stream.read(&mut buffer) {
            Ok(0) => return false,
            Ok(length) => input.extend_from_slice(buffer.get(..length).unwrap_or_default()),
            Err(error) => return error.kind() == ErrorKind::WouldBlock,
        }
    }
    false
}

/// Writes what the client takes; false if it has gone, or does not read.
fn write(mut stream: &TcpStream, output: &mut Vec<u8>) -> bool {
    while !output.is_empty() {
        match stream.write(output) {
            Ok(length) => drop(output.drain(..length)),
            Err(error) => {
                return error.kind() == ErrorKind::WouldBlock && output.len() < MAX_WAITING;
            }
        }
    }
    true
}
