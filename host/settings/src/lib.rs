//! Settings in TOML files, each declared once: daemon, simulator and scenarios share this.
//!
//! [`section!`] declares a section with the type, default, range and meaning of its keys.
//! [`explain()`] says what is wrong with a file that does not parse.

mod explain;
mod section;
mod value;

pub use explain::{expected, explain, explain_table, kind, list, quoted_after, shortened};
pub use section::{Declared, Key, Maps, Section, Via, Written, check_kind, or_default, toml_value};
pub use value::{
    Convert, Numbers, Rule, UpTo, ValueError, Worded, check, in_words, seconds, up_to,
};
