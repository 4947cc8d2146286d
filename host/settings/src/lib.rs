//! Settings in TOML files, each declared once: daemon, simulator and scenarios share this.
//!
//! [`section!`] declares a section with the type, default, range and meaning of its keys.
//! [`explain()`] says what is wrong with a file that does not parse.

mod error;
mod explain;
mod section;
mod tagged_section;
mod value;

pub use error::ValueError;
pub use explain::{expected, explain, explain_table, kind, list, quoted_after, shortened};
pub use section::{Declared, Key, Maps, Section, or_default, toml_value};
pub use tagged_section::{Written, check_kind};
pub use value::{Convert, Numbers, Rule, UpTo, Worded, check, in_words, seconds, up_to};
