//! Enumerations with words.

singletrack_control::words! {
    /// How a car stops.
    pub enum Stop {
        /// It rolls out.
        Coast = 1 "coast",
        /// It brakes.
        Brake = 2 "brake",
    }
}

#[test]
fn an_enumeration_has_words_numbers_and_documentation() {
    assert_eq!(Stop::ALL.map(Stop::name), ["coast", "brake"]);
    assert_eq!(Stop::named("brake"), Some(Stop::Brake));
    assert_eq!(Stop::named("brakes"), None);
    assert_eq!(Stop::Coast.to_string(), "coast");
    assert_eq!(Stop::Brake as u8, 2);
    assert_eq!(Stop::Brake.documentation().trim(), "It brakes.");
}
