//! The list of the sections.

use super::{
    ActuatorsSection, BoardSection, CompensationSection, ControlSection, EscSection,
    EstimatorSection, FenceSection, GovernorSection, ImuSection, LawSection, LimitsSection,
    LiveSection, MotionCaptureSection, PoseSection, RecordSection, SafetyFilterSection,
    SerialSection, ServoSection, SocketSection, SpeedSection, StateSection, SupervisorSection,
    TimingSection, WatchSection,
    outer_loop::OuterLoopKeys,
    reference::ReferenceKeys,
    section::{Declared as _, Section},
    vehicle::VehicleKeys,
};

/// Every section, in the order of the file.
pub const SECTIONS: &[Section] = &[
    SerialSection::SECTION,
    MotionCaptureSection::SECTION,
    PoseSection::SECTION,
    TimingSection::SECTION,
    LawSection::SECTION,
    OuterLoopKeys::SECTION,
    ReferenceKeys::SECTION,
    GovernorSection::SECTION,
    VehicleKeys::SECTION,
    LimitsSection::SECTION,
    EstimatorSection::SECTION,
    SupervisorSection::SECTION,
    WatchSection::SECTION,
    FenceSection::SECTION,
    BoardSection::SECTION,
    ServoSection::SECTION,
    EscSection::SECTION,
    SpeedSection::SECTION,
    ImuSection::SECTION,
    ActuatorsSection::SECTION,
    CompensationSection::SECTION,
    SafetyFilterSection::SECTION,
    ControlSection::SECTION,
    RecordSection::SECTION,
    StateSection::SECTION,
    SocketSection::SECTION,
    LiveSection::SECTION,
];
