//! The messages of a record: one declaration each, from which follow the type
//! that is encoded, the `ros2msg` schema that is embedded in the file, and the
//! fields that are printed.
//!
//! A field's documentation is its comment in the schema. What may be absent is
//! two fields there, `bool has_x` and `x`, because ROS messages have no options.

mod board;
mod code;
mod event;
mod field;
mod log;
mod pose;
mod tick;

pub(crate) use board::{StatusMessage, TelemetryMessage};
pub(crate) use code::Coded;
pub(crate) use field::Definition;
pub(crate) use log::{ConfigurationMessage, DropsMessage, LogMessage};
pub(crate) use pose::PoseMessage;
pub(crate) use tick::TickMessage;

use serde::{Serialize, de::DeserializeOwned};

use crate::value::Visitor;

/// The package that all messages belong to.
const PACKAGE: &str = "singletrack_msgs";

/// A message type.
pub(crate) trait Message: Clone + Serialize + DeserializeOwned {
    /// Its name within the package.
    const NAME: &'static str;

    /// Declares its fields.
    fn define(definition: &mut Definition);

    /// What stands where there is none.
    fn absent() -> Self;

    /// Walks through its fields.
    fn visit(&self, visitor: &mut dyn Visitor);
}

/// The name of a message's schema.
pub(crate) fn schema_name<M: Message>() -> String {
    format!("{PACKAGE}/msg/{}", M::NAME)
}

/// The text of a message's schema: its own definition, then those of all
/// messages within it.
pub(crate) fn schema_text<M: Message>() -> String {
    let mut definition = Definition::default();
    M::define(&mut definition);
    definition.finish()
}

/// Something recorded does not make sense.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum Senseless {
    #[error("{0} events in a tick, more than the {max} that a tick takes in", max = crate::MAX_EVENTS)]
    TooManyEvents(usize),
    #[error("{kind} without {part}")]
    PartMissing {
        kind: &'static str,
        part: &'static str,
    },
    #[error("a count of {0}, more than this machine can hold")]
    CountTooLarge(u64),
}

/// Declares a message: see the module.
macro_rules! message {
    (
        $(#[doc = $about:literal])*
        $type:ident as $name:literal {
            $( $(#[doc = $comment:literal])* $field:ident : $kind:ty, )*
        }
    ) => {
        $(#[doc = $about])*
        #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
        pub(crate) struct $type {
            $( $(#[doc = $comment])* pub(crate) $field: $kind, )*
        }

        impl $crate::message::Message for $type {
            const NAME: &'static str = $name;

            fn define(definition: &mut $crate::message::Definition) {
                use $crate::message::field::Field;
                $( definition.comment($about); )*
                $(
                    definition.blank();
                    $( definition.comment($comment); )*
                    <$kind as Field>::declare(stringify!($field), definition);
                )*
            }

            fn absent() -> Self {
                use $crate::message::field::Field;
                Self { $( $field: <$kind as Field>::absent(), )* }
            }

            fn visit(&self, visitor: &mut dyn $crate::value::Visitor) {
                use $crate::message::field::Field;
                $( Field::visit(&self.$field, stringify!($field), visitor); )*
            }
        }

        impl $crate::message::field::Field for $type {
            fn declare(name: &'static str, definition: &mut $crate::message::Definition) {
                definition.nested::<Self>(name, "");
            }

            fn absent() -> Self {
                <Self as $crate::message::Message>::absent()
            }

            fn visit(&self, name: &'static str, visitor: &mut dyn $crate::value::Visitor) {
                visitor.message(name, true, &|inner| {
                    $crate::message::Message::visit(self, inner);
                });
            }

            fn visit_absent(name: &'static str, visitor: &mut dyn $crate::value::Visitor) {
                visitor.message(name, false, &|inner| {
                    $crate::message::Message::visit(
                        &<Self as $crate::message::Message>::absent(),
                        inner,
                    );
                });
            }
        }
    };
}

use message;
