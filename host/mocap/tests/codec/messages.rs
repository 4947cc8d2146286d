//! Every message other than frames and model definitions.

use core::{net::Ipv4Addr, num::NonZeroU64};

use proptest::prelude::*;
use singletrack_mocap::{
    codec::{
        BitstreamVersion, ClientMessage, Connect, Connection, DataChannel, DecodeError, Echo,
        Response, ServerInfo, ServerMessage, UnsupportedVersion, bitstream_request,
    },
    encode::{self, EncodeError},
};

use crate::{encoded, with_fitting_header};

const ANY: BitstreamVersion = BitstreamVersion::V4_1;

fn motive() -> ServerInfo<'static> {
    ServerInfo {
        application: "Motive",
        application_version: [3, 1, 2, 1],
        natnet_version: [4, 1, 0, 0],
        connection: Some(Connection {
            ticks_per_second: NonZeroU64::new(10_000_000),
            data_channel: DataChannel {
                port: 1511,
                multicast: true,
                group: Ipv4Addr::new(239, 255, 42, 99),
            },
        }),
    }
}

#[test]
fn both_forms_of_server_info_are_decoded() {
    for info in [
        motive(),
        ServerInfo {
            natnet_version: [2, 9, 0, 0],
            connection: None,
            ..motive()
        },
    ] {
        let datagram = encoded(|out| encode::server_info(&info, out));
        let expected_len = if info.connection.is_some() { 279 } else { 264 };
        assert_eq!(datagram.len(), 4 + expected_len);
        let Ok(ServerMessage::ServerInfo(decoded)) = ServerMessage::decode(&datagram, ANY) else {
            panic!("not a server info");
        };
        assert_eq!(decoded, info);
    }
}

#[test]
fn garbage_after_the_servers_name_is_ignored() {
    let mut datagram = encoded(|out| encode::server_info(&motive(), out));
    datagram[4 + "Motive".len() + 1..4 + 256].fill(0xEE);
    let Ok(ServerMessage::ServerInfo(decoded)) = ServerMessage::decode(&datagram, ANY) else {
        panic!("not a server info");
    };
    assert_eq!(decoded, motive());
}

#[test]
fn a_server_info_of_another_length_is_refused() {
    let datagram = encoded(|out| encode::server_info(&motive(), out));
    for len in (4..datagram.len()).filter(|len| *len != 4 + 264) {
        let prefix = with_fitting_header(datagram[..len].to_vec());
        assert_eq!(
            ServerMessage::decode(&prefix, ANY).unwrap_err(),
            DecodeError::UnexpectedLength {
                message: "SERVERINFO",
                actual: len - 4
            }
        );
    }
}

#[test]
fn versions_outside_the_range_are_refused_by_number() {
    for (major, minor) in [(2, 6), (2, 5), (1, 9), (0, 0), (4, 5), (5, 0), (255, 255)] {
        let refusal = BitstreamVersion::new(major, minor).unwrap_err();
        assert_eq!(refusal, UnsupportedVersion { major, minor });
        let text = refusal.to_string();
        assert!(
            text.contains(&format!("{major}.{minor} is not supported"))
                && text.contains("2.7 to 4.4"),
            "{text}"
        );
    }
    for (major, minor) in [(2, 7), (2, 11), (3, 0), (3, 1), (4, 0), (4, 4)] {
        let version = BitstreamVersion::new(major, minor).unwrap();
        assert_eq!(version.to_string(), format!("{major}.{minor}"));
        assert_eq!(BitstreamVersion::from_wire(version.to_wire()), Ok(version));
    }
}

#[test]
fn the_messages_of_a_client_are_decoded() {
    for message in [
        ClientMessage::Connect(Connect {
            name: "Singletrack",
            requested_bitstream: None,
        }),
        ClientMessage::Connect(Connect {
            name: "",
            requested_bitstream: Some([4, 1, 0, 0]),
        }),
        ClientMessage::Request("Bitstream,4.1"),
        ClientMessage::RequestModelDefinitions,
        ClientMessage::KeepAlive,
        ClientMessage::Disconnect,
        ClientMessage::EchoRequest {
            client_stamp: 0x0123_4567_89AB_CDEF,
        },
        ClientMessage::Discovery,
    ] {
        let mut datagram = encoded(|out| encode::client_message(&message, out));
        assert_eq!(ClientMessage::decode(&datagram), Ok(message));
        // The vendor's sample client sends one NUL beyond the declared length.
        datagram.push(0);
        assert_eq!(ClientMessage::decode(&datagram), Ok(message));
        datagram.push(0);
        assert!(matches!(
            ClientMessage::decode(&datagram),
            Err(DecodeError::LengthMismatch { .. })
        ));
    }
}

#[test]
fn a_connect_message_has_the_length_that_servers_need() {
    let message = ClientMessage::Connect(Connect {
        name: "Singletrack",
        requested_bitstream: None,
    });
    assert!(encoded(|out| encode::client_message(&message, out)).len() >= 4 + 264);
}

#[test]
fn a_connect_message_may_be_short_or_empty_but_not_longer_than_known() {
    let connect = |payload_len: usize| with_fitting_header(vec![0; 4 + payload_len]);
    let anonymous = ClientMessage::Connect(Connect {
        name: "",
        requested_bitstream: None,
    });
    for len in [0, 5, 264, 269, 270, 271] {
        assert_eq!(ClientMessage::decode(&connect(len)), Ok(anonymous));
    }
    assert_eq!(
        ClientMessage::decode(&connect(272)),
        Err(DecodeError::UnexpectedLength {
            message: "CONNECT",
            actual: 272
        })
    );
}

#[test]
fn a_bitstream_request_is_recognised() {
    assert_eq!(
        bitstream_request("Bitstream,4.1"),
        Some(Ok(BitstreamVersion::V4_1))
    );
    assert_eq!(
        bitstream_request("bitstream,3.0.0.0"),
        Some(Ok(BitstreamVersion::V3_0))
    );
    assert_eq!(
        bitstream_request("Bitstream,9.9"),
        Some(Err(UnsupportedVersion { major: 9, minor: 9 }))
    );
    assert!(matches!(bitstream_request("Bitstream,x"), Some(Err(_))));
    assert_eq!(bitstream_request("TimelinePlay"), None);
}

#[test]
fn small_replies_are_decoded() {
    let status = encoded(|out| encode::response_status(-3, out));
    assert!(matches!(
        ServerMessage::decode(&status, ANY),
        Ok(ServerMessage::Response(Response::Status(-3)))
    ));
    let text = b"\x03\0\x06\x00120.0\0";
    assert!(matches!(
        ServerMessage::decode(text, ANY),
        Ok(ServerMessage::Response(Response::Text("120.0")))
    ));
    let message = b"\x08\0\x06\0hello\0";
    assert!(matches!(
        ServerMessage::decode(message, ANY),
        Ok(ServerMessage::Text("hello"))
    ));
    assert!(matches!(
        ServerMessage::decode(&encoded(encode::disconnect), ANY),
        Ok(ServerMessage::Disconnect)
    ));
    assert!(matches!(
        ServerMessage::decode(&encoded(encode::unrecognized), ANY),
        Ok(ServerMessage::Unrecognized)
    ));
}

#[test]
fn texts_that_would_be_misread_are_not_encoded() {
    let mut out = [0; 300];
    let request = ClientMessage::Request("a\0b");
    assert_eq!(
        encode::client_message(&request, &mut out),
        Err(EncodeError::InteriorNul { field: "request" })
    );
    let long = "x".repeat(256);
    let info = ServerInfo {
        application: &long,
        ..motive()
    };
    assert_eq!(
        encode::server_info(&info, &mut out),
        Err(EncodeError::NameTooLong {
            field: "server name",
            len: 256,
            max: 255
        })
    );
}

#[test]
fn a_text_must_end_with_its_only_nul() {
    let packet = |payload: &[u8]| {
        let mut datagram = vec![8, 0, 0, 0];
        datagram.extend_from_slice(payload);
        with_fitting_header(datagram)
    };
    assert!(ServerMessage::decode(&packet(b"hello\0"), ANY).is_ok());
    assert_eq!(
        ServerMessage::decode(&packet(b"hello"), ANY).unwrap_err(),
        DecodeError::UnterminatedString {
            field: "text",
            offset: 4
        }
    );
    assert_eq!(
        ServerMessage::decode(&packet(b"hi\0there\0"), ANY).unwrap_err(),
        DecodeError::TrailingBytes {
            field: "the text",
            offset: 7,
            count: 6
        }
    );
    assert_eq!(
        ServerMessage::decode(&packet(b"\xFF\0"), ANY).unwrap_err(),
        DecodeError::InvalidUtf8 {
            field: "text",
            offset: 4
        }
    );
}

#[test]
fn messages_of_the_other_side_and_unknown_ones_are_refused_by_id() {
    let request = encoded(|out| encode::client_message(&ClientMessage::KeepAlive, out));
    assert_eq!(
        ServerMessage::decode(&request, ANY).unwrap_err(),
        DecodeError::UnexpectedMessage { id: 10 }
    );
    assert_eq!(
        ClientMessage::decode(&[44, 0, 0, 0]),
        Err(DecodeError::UnexpectedMessage { id: 44 })
    );
}

proptest! {
    #[test]
    fn an_echo_is_decoded_and_its_prefixes_are_not(client_stamp: u64, server_ticks: u64) {
        let sent = Echo { client_stamp, server_ticks };
        let datagram = encoded(|out| encode::echo_response(sent, out));
        let Ok(ServerMessage::Echo(received)) = ServerMessage::decode(&datagram, ANY) else {
            panic!("not an echo");
        };
        prop_assert_eq!(received, sent);
        for len in 4..datagram.len() {
            let prefix = with_fitting_header(datagram[..len].to_vec());
            prop_assert!(ServerMessage::decode(&prefix, ANY).is_err());
        }
    }
}
