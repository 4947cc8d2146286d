//! Bytes as real programs send them.

use singletrack_mocap::{
    qualisys::{
        BodyList,
        packet::{ByteOrder, Component, FrameBody, Kind, Packet, write_frame},
    },
    vrpn::message::{COOKIE, Message, PING, POSE, TYPE_DESCRIPTION, description},
};

fn bytes(hex: &str) -> Vec<u8> {
    let digits: Vec<_> = hex.bytes().filter(u8::is_ascii_hexdigit).collect();
    digits
        .chunks(2)
        .map(|pair| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap())
        .collect()
}

/// A pose as VRPN's own library (07.38) writes it, with its stamp 1.5 s after 1970.
const VRPN_POSE: &str = "
    00000058 00000001 0007a120 00000001 00000004 00000000
    00000001 00000001
    3ff8000000000000 c000000000000000 3fd0000000000000
    0000000000000000 0000000000000000 3fe0000000000000 3febb67ae8584caa";

#[test]
fn a_pose_of_vrpn() {
    let wire = bytes(VRPN_POSE);
    let (message, length) = Message::read(&wire).unwrap().unwrap();
    assert_eq!(length, 88);
    assert_eq!(
        (message.stamp_us, message.sender, message.kind),
        (1_500_000, 1, 4)
    );
    let pose = message.pose().unwrap();
    assert_eq!(pose.sensor, 1);
    assert_eq!(pose.position_m, [1.5, -2.0, 0.25]);
    assert_eq!(
        pose.orientation_xyzw,
        [0.0, 0.0, 0.5, 0.866_025_403_784_438_6]
    );
    // The padding before the numbers is not read, and is written as zeros.
    let mut written = Vec::new();
    let body = pose.body();
    Message {
        body: &body,
        ..message
    }
    .write(0, &mut |part| written.extend_from_slice(part));
    let mut expected = wire.clone();
    expected[31] = 0;
    assert_eq!(written, expected);
}

#[test]
fn descriptions_of_vrpn_are_padded_and_their_length_is_not() {
    let mut written = Vec::new();
    let body = description(PING);
    let message = Message {
        stamp_us: 0,
        sender: 16,
        kind: TYPE_DESCRIPTION,
        body: &body,
    };
    message.write(19, &mut |part| written.extend_from_slice(part));
    assert_eq!(written.len(), 56);
    assert_eq!(written[..4], 51_u32.to_be_bytes());
    assert_eq!(written[20..28], [0, 0, 0, 19, 0, 0, 0, 23]);
    assert_eq!(&written[28..51], b"vrpn_Base ping_message\0");
    let (read, _) = Message::read(&written).unwrap().unwrap();
    assert_eq!(read.described(), Some(PING.as_bytes()));
    assert_ne!(PING, POSE);
    assert_eq!(&COOKIE[..19], b"vrpn: ver. 07.38  0");
    // Without its last byte it is not complete; without a header's length it is none.
    assert_eq!(Message::read(&written[..55]), Ok(None));
    assert!(Message::read(&[0, 0, 0, 23]).is_err() || Message::read(&[0, 0, 0, 23, 0]).is_err());
}

/// A frame of QTM as its protocol's document lays it out: one body with residual, big-endian.
const QTM_FRAME: &str = "
    0000005c 00000003 0000000000012345 00000007 00000001
    00000044 0000000b 00000001 0000 0000
    447a0000 c47a0000 42c80000
    00000000 3f800000 00000000 bf800000 00000000 00000000 00000000 00000000 3f800000
    3f000000
    ";

#[test]
fn a_frame_of_qtm_in_both_orders() {
    let wire = bytes(QTM_FRAME);
    let body = FrameBody {
        position_mm: [1_000.0, -1_000.0, 100.0],
        axes: [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
        residual_mm: 0.5,
    };
    assert_eq!(body.euler_deg(), [0.0, 0.0, 90.0]);
    for order in [ByteOrder::Big, ByteOrder::Little] {
        let mut written = Vec::new();
        let components = [Component::WithResiduals];
        write_frame(order, 0x12345, 7, &[body], &components, &mut |part| {
            written.extend_from_slice(part);
        });
        if order == ByteOrder::Big {
            assert_eq!(written, wire);
        }
        assert_eq!(ByteOrder::of(*written.first_chunk().unwrap()), order);
        let (packet, length) = Packet::read(order, &written).unwrap().unwrap();
        assert_eq!((packet.kind, length), (Kind::Data, 92));
        let frame = packet.frame(order).unwrap();
        assert_eq!((frame.stamp_us, frame.number), (0x12345, 7));
        assert_eq!(frame.bodies().collect::<Vec<_>>(), [body]);
    }
}

#[test]
fn names_of_qtm_in_xml_of_old_and_new_versions() {
    let old = "<QTM_Parameters_Ver_1.13><The_6D><Bodies>2</Bodies>\
               <Body><Name>car</Name><RGBColor>255</RGBColor><Point><X>1</X></Point></Body>\
               <Body><Name>R&amp;D &lt;1&gt;</Name></Body><Euler/></The_6D></QTM>";
    let new = "<QTM_Parameters_Ver_1.25><The_6D>\n<Body>\n<Name>car</Name><Enabled>true</Enabled>\
               <Points><Point X=\"1\" Name=\"Name\"/></Points></Body><Body><Enabled>true</Enabled>\
               </Body></The_6D><The_3D><Body><Name>no</Name></Body></The_3D>";
    let names = |xml: &str| {
        BodyList::new(xml.as_bytes())
            .map(|name| String::from_utf8(name.to_vec()).unwrap())
            .collect::<Vec<_>>()
    };
    assert_eq!(names(old), ["car", "R&D <1>"]);
    assert_eq!(names(new), ["car", ""]);
    for nothing in [
        "",
        "<The_6D>",
        "<The_3D><Body><Name>a</Name></Body></The_3D>",
    ] {
        assert!(names(nothing).is_empty());
    }
}

#[test]
fn a_list_without_ends_is_read_in_one_go() {
    let bodies = "<The_6D>".to_owned() + &"<Body><Name>a".repeat(50_000);
    assert_eq!(BodyList::new(bodies.as_bytes()).count(), 0);
    let nested = bodies + &"</Name></Body>".repeat(50_000);
    assert_eq!(BodyList::new(nested.as_bytes()).count(), 1);
}
