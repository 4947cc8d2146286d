//! The NatNet wire format: values to bytes, for both sides.
//!
//! Every function writes one whole datagram to the front of `out` and returns
//! its length. The server's half feeds simulated cameras and tests.

mod client;
mod error;
mod frame;
mod model;
mod server;
mod writer;

pub use client::client_message;
pub use error::EncodeError;
pub use frame::{
    AnalogDevice, Asset, BodyMarker, FrameContent, LabelledMarker, MarkerSet, Sections, Skeleton,
    frame,
};
pub use model::{Dataset, DefinitionMarker, model_definitions};
pub use server::{
    disconnect, echo_response, response_status, response_text, server_info, text, unrecognized,
};
