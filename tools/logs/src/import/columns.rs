//! The sensors and commands of a log, column by column.

use super::{
    log::ImportError,
    log::Log,
    map::{Acceleration, ImuSection, Map, MotorSection, Quantity, interpolation, nanoseconds},
    row::{Header, Row},
    samples::Series,
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
        Ok(Self {
            poses: Poses::find(header, &map.pose)?,
            imu: match &map.imu {
                None => None,
                Some(imu) => Some(inertial(header, imu)?),
            },
            motor: motor(header, &map.motor)?,
            driving: match &map.driving {
                None => None,
                Some(section) => {
                    let place =
                        header.find("driving.column", section.messages(), &section.column)?;
                    Some(Sensor::new([Column::flag(place)], None, 0))
                }
            },
            steering: {
                let (section, key) = (&map.steering, "steering.column");
                let place = header.find(key, section.messages(), &section.column)?;
                let delay_ns = nanoseconds(section.delay_s);
                Sensor::new([Column::plain(place)], None, delay_ns)
            },
            speed_command: match &map.speed_command {
                None => None,
                Some(section) => {
                    let key = "speed_command.speed";
                    let column = Column::find(header, key, section.messages(), &section.speed)?;
                    Some(Sensor::new([column], None, nanoseconds(section.delay_s)))
                }
            },
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
        let held = |sensor: Sensor<1>| Series::new(sensor.samples, None);
        let inertial = self.imu.zip(map.imu.as_ref());
        let mut steering = self.steering.samples;
        for sample in &mut steering {
            sample.values = sample.values.map(|command| map.steering.angle(command));
        }
        Log {
            start_wall_ns,
            sorted,
            end_ns,
            exposures_are_known: map.pose.exposures_hz.is_some(),
            poses: self.poses.poses,
            inertial: inertial.map(|(sensor, imu)| {
                let interpolation = interpolation(imu.interpolate_hz, imu.longest_gap_s);
                Series::new(sensor.samples, interpolation)
            }),
            motor_speed: {
                let interpolation =
                    interpolation(map.motor.interpolate_hz, map.motor.longest_gap_s);
                Series::new(self.motor.samples, interpolation)
            },
            steering: Series::new(steering, None),
            speed_command: self.speed_command.map(held),
            driving: self.driving.map(held),
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
    Ok(Sensor::new(columns, changes, nanoseconds(section.delay_s)))
}

fn motor(header: &mut impl Header, section: &MotorSection) -> Result<Sensor<1>, ImportError> {
    let messages = section.messages();
    let column = Column::find(header, "motor.speed", messages, &section.speed)?;
    let key = "motor.new_when_changes";
    let changes = header.find_if(key, messages, &section.new_when_changes)?;
    Ok(Sensor::new([column], changes, nanoseconds(section.delay_s)))
}
