//! The sensors and commands of a log, column by column.

use super::{
    log::{ImportError, Log},
    map::{Acceleration, ImuSection, Map, MotorSection, Quantity, interpolation, nanoseconds},
    row::{Header, Row},
    sensor::{Column, Poses, Sensor},
};

/// The columns of a log, with what has been read of them.
pub(super) struct Columns<'a> {
    poses: Poses<'a>,
    imu: Option<Sensor<3>>,
    motor: Sensor<1>,
    driving: Option<Sensor<1>>,
    steering: Sensor<1>,
    speed_command: Option<Sensor<1>>,
}

impl<'a> Columns<'a> {
    /// Finds the columns that the map names.
    pub(super) fn find(header: &mut impl Header, map: &'a Map) -> Result<Self, ImportError> {
        let poses = Poses::find(header, &map.pose)?;
        let imu = map.imu.as_ref().map(|imu| inertial(header, imu));
        let (imu, motor) = (imu.transpose()?, motor(header, &map.motor)?);
        let driving = map.driving.as_ref().map(|section| {
            let place = header.find("driving.column", section.messages(), &section.column);
            place.map(|place| Sensor::held(Column::flag(place), 0))
        });
        let driving = driving.transpose()?;
        let (section, key) = (&map.steering, "steering.column");
        let place = header.find(key, section.messages(), &section.column)?;
        let steering = Sensor::held(Column::plain(place), nanoseconds(section.delay_s));
        let speed_command = map.speed_command.as_ref().map(|section| {
            let key = "speed_command.speed";
            let column = Column::find(header, key, section.messages(), &section.speed);
            column.map(|column| Sensor::held(column, nanoseconds(section.delay_s)))
        });
        Ok(Self {
            poses,
            imu,
            motor,
            driving,
            steering,
            speed_command: speed_command.transpose()?,
        })
    }

    /// Takes what a row has.
    pub(super) fn take(&mut self, row: &impl Row, time_ns: u64) -> Result<(), ImportError> {
        self.poses.take(row, time_ns)?;
        if let Some(imu) = &mut self.imu {
            imu.take(row, time_ns)?;
        }
        let others = [
            Some(&mut self.motor),
            self.driving.as_mut(),
            Some(&mut self.steering),
            self.speed_command.as_mut(),
        ];
        let mut others = others.into_iter().flatten();
        others.try_for_each(|sensor| sensor.take(row, time_ns))
    }

    /// What the rows say.
    pub(super) fn log(self, map: &Map, start_wall_ns: u64, end_ns: u64, sorted: u64) -> Log {
        let mut steering = self.steering.series;
        for sample in &mut steering.samples {
            sample.values = sample.values.map(|command| map.steering.angle(command));
        }
        Log {
            start_wall_ns,
            sorted,
            end_ns,
            exposures_are_known: map.pose.exposures_hz.is_some(),
            poses: self.poses.poses,
            inertial: self.imu.map(|sensor| sensor.series),
            motor_speed: self.motor.series,
            steering,
            speed_command: self.speed_command.map(|sensor| sensor.series),
            driving: self.driving.map(|sensor| sensor.series),
            tick_ns: u64::from(map.tick_ms) * 1_000_000,
            phase_ns: match map.pose.exposures_hz {
                None => 0,
                Some(_) => u64::from(map.tick_ms) * 200_000,
            },
        }
    }
}

fn inertial(header: &mut impl Header, section: &ImuSection) -> Result<Sensor<3>, ImportError> {
    let messages = section.messages();
    let yaw_rate = Column::find(header, "imu.yaw_rate", messages, &section.yaw_rate)?;
    let mut acceleration = |key, quantity: &Option<Quantity<Acceleration>>| match quantity {
        Some(quantity) => Column::find(header, key, messages, quantity),
        None => Ok(yaw_rate.unmeasured()),
    };
    let columns = [
        acceleration("imu.forward_acceleration", &section.forward_acceleration)?,
        acceleration("imu.left_acceleration", &section.left_acceleration)?,
        yaw_rate,
    ];
    let changes = header.find_if("imu.new_when_changes", messages, &section.new_when_changes)?;
    let interpolation = interpolation(section.interpolate_hz, section.longest_gap_s);
    let delay_ns = nanoseconds(section.delay_s);
    Ok(Sensor::new(columns, changes, delay_ns, interpolation))
}

fn motor(header: &mut impl Header, section: &MotorSection) -> Result<Sensor<1>, ImportError> {
    let messages = section.messages();
    let column = Column::find(header, "motor.speed", messages, &section.speed)?;
    let key = "motor.new_when_changes";
    let changes = header.find_if(key, messages, &section.new_when_changes)?;
    let interpolation = interpolation(section.interpolate_hz, section.longest_gap_s);
    let delay_ns = nanoseconds(section.delay_s);
    Ok(Sensor::new([column], changes, delay_ns, interpolation))
}
