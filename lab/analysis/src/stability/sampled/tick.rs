//! The linear map of one tick.

use nalgebra::{DMatrix, DVector};

use super::{
    SampledLoop,
    plant::{
        Compensation, Delay, Modelled, POSITION, Plant, Prediction, SIDESLIP, STEERING, Steering,
        YAW, YAW_RATE,
    },
};
use crate::stability::{
    characteristic::symbols,
    closed_loop::{Belief, Law},
};

/// Where the state of the loop has what. The states of the plant are first.
struct Layout {
    /// The steering angle as the predictor models it.
    modelled: Option<usize>,
    /// The commands of the last ticks, from the newest to the oldest.
    commands: usize,
    pending: usize,
    /// Those of them that the servo takes: the same without servo frames.
    taken: usize,
    /// The held pose: position and yaw.
    held: usize,
    /// What is measured late: which state, the first of its values, and its age. The values are
    /// those of the last ticks, from the newest to the oldest.
    aged: Vec<(usize, usize, Delay)>,
    /// The pilot's model: wheels, yaw rate, sideslip.
    model: Option<usize>,
    size: usize,
}

impl Layout {
    fn unit(&self, at: usize) -> DVector<f64> {
        let mut unit = DVector::zeros(self.size);
        unit[at] = 1.0;
        unit
    }

    /// The command that was given `age` ticks before; `command` is the new one.
    fn given(&self, command: Option<&DVector<f64>>, age: usize) -> DVector<f64> {
        match (age, command) {
            (0, Some(command)) => command.clone(),
            _ => self.unit(self.commands + age.max(1) - 1),
        }
    }

    fn modelled(&self, model: usize) -> Modelled {
        Modelled {
            wheels: self.unit(model),
            yaw_rate: self.unit(model + 1),
            sideslip: self.unit(model + 2),
        }
    }
}

impl SampledLoop {
    /// The map of one tick on the car's state, the pending commands from the newest to the
    /// oldest, the held pose (position, yaw), and what else is remembered. The servo takes the
    /// command of this tick, or keeps the last one.
    pub(super) fn tick(&self, has_pose: bool, takes: bool) -> DMatrix<f64> {
        let (speed, period) = (self.closed_loop.speed, self.timing.period);
        let steering = self.steering();
        let plant = Plant::new(&self.closed_loop.vehicle, speed, steering);
        let delay = self.whole_delay();
        let modelled_delay = self.modelled_delay();
        let layout = self.layout(plant.states());
        let states = plant.states();

        let command = self.command(&layout, steering, has_pose);
        let taken = match takes {
            true => command.clone(),
            false => layout.unit(layout.taken),
        };
        let mut map = DMatrix::<f64>::zeros(layout.size, layout.size);
        map.view_mut((0, 0), (states, states))
            .copy_from(&plant.transition(period));
        let inputs = plant.split_input(period, delay.late);
        add_input(&mut map, &layout, &taken, 0, delay.ticks, &inputs);
        for &(state, first, age) in &layout.aged {
            // The state so late before the next tick.
            let until = period - age.late;
            let transition = plant.transition(until);
            map.view_mut((first, 0), (1, states))
                .copy_from(&transition.row(state));
            let inputs = plant
                .split_input(until, delay.late.min(until))
                .map(|input| DVector::from_element(1, input[state]));
            add_input(&mut map, &layout, &taken, first, delay.ticks, &inputs);
            for tick in 1..=age.ticks {
                map[(first + tick, first + tick - 1)] = 1.0;
            }
        }
        if let (Some(model), Some(compensation)) = (layout.model, self.timing.compensation) {
            let given = |age| layout.given(Some(&command), age);
            let now = layout.modelled(model);
            let next = compensation.run(speed, period, period, now, given, |_, _| {});
            map.set_row(model, &next.wheels.transpose());
            map.set_row(model + 1, &next.yaw_rate.transpose());
            map.set_row(model + 2, &next.sideslip.transpose());
        }
        if let (Some(row), Some(delay), Some(prediction)) =
            (layout.modelled, modelled_delay, self.timing.prediction)
        {
            let follows = |time: f64| 1.0 - libm::exp(-time / prediction.lag);
            let rest = period - delay.late;
            map[(row, row)] = libm::exp(-period / prediction.lag);
            let begin = libm::exp(-rest / prediction.lag) * follows(delay.late);
            let inputs = [begin, follows(rest)].map(|input| DVector::from_element(1, input));
            add_input(&mut map, &layout, &taken, row, delay.ticks, &inputs);
        }
        for (first, newest) in [(layout.taken, &taken), (layout.commands, &command)] {
            map.set_row(first, &newest.transpose());
            for age in 1..layout.pending {
                map[(first + age, first + age - 1)] = 1.0;
            }
        }
        for pose in [POSITION, YAW] {
            let from = if has_pose { pose } else { layout.held + pose };
            map[(layout.held + pose, from)] = 1.0;
        }
        if self.timing.position_gain == 0.0 {
            // Without the outer loop nothing depends on the position.
            map = map
                .remove_rows_at(&[POSITION, layout.held + POSITION])
                .remove_columns_at(&[POSITION, layout.held + POSITION]);
        }
        map
    }

    fn steering(&self) -> Steering {
        match (self.timing.servo, self.closed_loop.law) {
            (Some(servo), _) => Steering::Servo(servo.lag),
            (None, Law::FrontPoint) => Steering::Rate,
            (None, Law::VelocityPoint) => Steering::Angle,
        }
    }

    /// The delay from a tick to the wheels.
    fn whole_delay(&self) -> Delay {
        let dead_time = self.timing.servo.map_or(0.0, |servo| servo.dead_time);
        Delay::new(self.timing.delay + dead_time, self.timing.period)
    }

    fn modelled_delay(&self) -> Option<Delay> {
        self.timing
            .prediction
            .map(|prediction| prediction.delay)
            .or(self.timing.compensation.map(|by| by.servo.dead_time))
            .map(|delay| Delay::new(delay, self.timing.period))
    }

    /// The layout of the loop's state, of which the first are those of the plant.
    fn layout(&self, states: usize) -> Layout {
        let delay = self.whole_delay();
        let pending = 1 + self
            .modelled_delay()
            .map_or(delay.ticks, |other| other.ticks.max(delay.ticks));
        let commands = states + usize::from(self.timing.prediction.is_some());
        let mut layout = Layout {
            modelled: self.timing.prediction.map(|_| states),
            commands,
            pending,
            taken: commands,
            held: commands + pending,
            aged: Vec::new(),
            model: None,
            size: commands + pending + 2,
        };
        if self.timing.servo_frame > 1 {
            layout.taken = layout.size;
            layout.size += pending;
        }
        for (state, age) in [
            (YAW_RATE, self.timing.ages.yaw_rate),
            (SIDESLIP, self.timing.ages.sideslip),
        ] {
            // An exact prediction knows what has happened since.
            if age > 0.0 && self.timing.prediction.is_none() {
                let age = Delay::new(age, self.timing.period);
                layout.aged.push((state, layout.size, age));
                layout.size += age.ticks + 1;
            }
        }
        if self.timing.compensation.is_some() {
            layout.model = Some(layout.size);
            layout.size += 3;
        }
        layout
    }

    /// The name of each state of the loop, in the order of [`SampledLoop::tick`].
    pub(super) fn names(&self) -> Vec<String> {
        const PLANT: [&str; 5] = ["y", "yaw", "yaw_rate", "sideslip", "wheels"];
        let states = match self.steering() {
            Steering::Angle => 4,
            Steering::Rate | Steering::Servo(_) => 5,
        };
        let layout = self.layout(states);
        let mut names = vec![String::new(); layout.size];
        for (name, plant) in names.iter_mut().zip(&PLANT[..states]) {
            *name = (*plant).to_owned();
        }
        if let Some(at) = layout.modelled {
            names[at] = "modelled_wheels".to_owned();
        }
        for age in 0..layout.pending {
            names[layout.taken + age] = format!("pulse_{}", age + 1);
            names[layout.commands + age] = format!("command_{}", age + 1);
        }
        names[layout.held + POSITION] = "held_y".to_owned();
        names[layout.held + YAW] = "held_yaw".to_owned();
        for (state, first, age) in &layout.aged {
            for tick in 0..=age.ticks {
                names[first + tick] = format!("{}_{}", PLANT[*state], tick + 1);
            }
        }
        if let Some(model) = layout.model {
            for (at, of) in ["wheels", "yaw_rate", "sideslip"].iter().enumerate() {
                names[model + at] = format!("model_{of}");
            }
        }
        if self.timing.position_gain == 0.0 {
            names.retain(|name| name != "y" && name != "held_y");
        }
        names
    }

    /// The new command as a linear combination of the state of the loop.
    fn command(&self, layout: &Layout, steering: Steering, has_pose: bool) -> DVector<f64> {
        // What the controller measures: position, yaw, yaw rate, sideslip, steering.
        let mut measured = DMatrix::<f64>::zeros(STEERING + 1, layout.size);
        for state in 0..STEERING {
            let is_pose = state == POSITION || state == YAW;
            let from = if is_pose && !has_pose {
                layout.held + state
            } else {
                state
            };
            measured[(state, from)] = 1.0;
        }
        for &(state, first, age) in &layout.aged {
            measured.set_row(state, &layout.unit(first + age.ticks).transpose());
        }
        if let (Some(model), Some(compensation)) = (layout.model, self.timing.compensation) {
            return self.compensated(&compensation, measured, layout, model);
        }
        let angle = match (steering, layout.modelled) {
            (_, Some(modelled)) => modelled,
            // The controller's own integral of the rate.
            (Steering::Servo(_), None) => layout.commands,
            (Steering::Rate, None) => STEERING,
            // The law has no use for it.
            (Steering::Angle, None) => layout.commands,
        };
        measured[(STEERING, angle)] = 1.0;
        let measured = match &self.timing.prediction {
            Some(prediction) => self.predicted(prediction, measured, layout),
            None => measured,
        };
        let command = measured.transpose() * self.gains();
        if self.closed_loop.law == Law::FrontPoint && steering != Steering::Rate {
            // The law's rate is integrated to an angle, which is sent at once.
            let mut angle = command * self.timing.period;
            angle[layout.commands] += 1.0;
            angle
        } else {
            command
        }
    }

    /// The command of the pilot's compensation.
    fn compensated(
        &self,
        compensation: &Compensation,
        measured: DMatrix<f64>,
        layout: &Layout,
        model: usize,
    ) -> DVector<f64> {
        let predicted = compensation.predicted(
            self.closed_loop.speed,
            self.timing.period,
            measured,
            layout.modelled(model),
            |age| layout.given(None, age),
        );
        let rate = predicted.transpose() * self.gains();
        predicted.row(STEERING).transpose() + rate * compensation.lead(self.timing.period)
    }

    /// The state when a command of this tick acts, by the models of servo and car, under the
    /// commands that are pending; the newest of them is held.
    fn predicted(
        &self,
        prediction: &Prediction,
        measured: DMatrix<f64>,
        layout: &Layout,
    ) -> DMatrix<f64> {
        let servo = Steering::Servo(prediction.lag);
        let model = Plant::new(&prediction.vehicle, self.closed_loop.speed, servo);
        let delay = Delay::new(prediction.delay, self.timing.period);
        let mut predicted = measured;
        let mut left = prediction.horizon();
        for age in (1..=delay.ticks + 1).rev() {
            let time = if age == 1 {
                left
            } else if age == delay.ticks + 1 {
                delay.late
            } else {
                self.timing.period
            };
            if time > 0.0 {
                predicted = model.transition(time) * predicted;
                let mut column = predicted.column_mut(layout.taken + age - 1);
                column += model.held(time);
                left -= time;
            }
        }
        predicted
    }

    /// The linearised law: the command as a linear combination of position, yaw, yaw rate,
    /// sideslip and steering.
    fn gains(&self) -> DVector<f64> {
        let closed_loop = &self.closed_loop;
        let (p, v) = (closed_loop.point_distance, closed_loop.speed);
        let deviation = closed_loop.deviation;
        let [m, _, l_f, l_r, c_f, c_r] = symbols(&closed_loop.vehicle);
        let l_f = l_f + deviation;
        let gain = self.timing.position_gain;
        DVector::from_vec(match closed_loop.law {
            // u = (v_Py - v (yaw + sideslip) - l_f r) / p - r, with
            // v_Py = -gain (y + l_f yaw + p (yaw + steering)).
            Law::FrontPoint => vec![
                -gain / p,
                -(gain * (l_f + p) + v) / p,
                -l_f / p - 1.0,
                -v / p,
                -gain,
            ],
            // turn rate = (v_Py - v (yaw + sideslip)) / p, with
            // v_Py = -gain (y + p (yaw + sideslip)).
            Law::VelocityPoint => {
                let l_r = match closed_loop.belief {
                    Belief::CentreOfMass => l_r - deviation,
                    Belief::FrontAxle => l_r,
                };
                let turning = m * v / c_f;
                let course = -turning * (gain + v / p);
                vec![
                    -turning * gain / p,
                    course,
                    -(c_r * l_r - c_f * l_f) / (c_f * v),
                    course + (c_r + c_f) / c_f,
                    0.0,
                ]
            }
        })
    }
}

/// Adds the input of a tick to the states from `row` on: the command at its beginning is one
/// older than the one at its end, which is `ticks` old.
fn add_input(
    map: &mut DMatrix<f64>,
    layout: &Layout,
    command: &DVector<f64>,
    row: usize,
    ticks: usize,
    [begin, end]: &[DVector<f64>; 2],
) {
    for (input, age) in [(begin, ticks + 1), (end, ticks)] {
        if age == 0 {
            let mut rows = map.rows_mut(row, input.len());
            rows += input * command.transpose();
        } else {
            let mut column = map.view_mut((row, layout.taken + age - 1), (input.len(), 1));
            column += input;
        }
    }
}
