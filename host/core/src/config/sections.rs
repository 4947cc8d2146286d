//! The list of the sections.

use singletrack_settings::{Declared as _, Section};

use super::{
    ActuatorsSection, BoardSection, CompensationSection, ControlSection, EscSection,
    EstimatorSection, FenceSection, GovernorSection, ImuSection, LawSection, LimitsSection,
    LiveSection, MotionCaptureSection, NeighboursSection, OnlineCalibrationSection, PageSection,
    PoseSection, RecordSection, SafetyFilterSection, SerialSection, ServoSection, SocketSection,
    SpeedSection, StateSection, SupervisorSection, TimingSection, TuningSection, WatchSection,
    outer_loop::OuterLoopKeys, reference::ReferenceKeys, vehicle::VehicleKeys,
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
    NeighboursSection::SECTION,
    TuningSection::SECTION,
    OnlineCalibrationSection::SECTION,
    ControlSection::SECTION,
    RecordSection::SECTION,
    StateSection::SECTION,
    SocketSection::SECTION,
    LiveSection::SECTION,
    PageSection::SECTION,
];
