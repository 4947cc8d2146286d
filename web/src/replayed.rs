//! The replay of a record, bit for bit.

use std::{collections::BTreeMap, error::Error, io::Cursor, path::Path};

use serde_json::json;
use singletrack_core::{Config, state_stream::States, top_view};
use singletrack_record::{Digest, Ending, Entry, Reader, Replay, Topic};

/// Ticks from one state to the next.
const EVERY: u64 = 5;

/// Replays a record and compares all outputs; with its states, to be drawn.
pub(crate) fn replay(record: Vec<u8>) -> Result<Vec<u8>, Box<dyn Error>> {
    let bytes = record.len();
    let mut reader = Reader::from_read(Cursor::new(record), Path::new("the record"))?
        .only(&[Topic::Configuration, Topic::Tick]);
    let meta = &reader.meta;
    let config = Config::from_toml(&meta.configuration)?;
    let (software, seed) = (meta.software.clone(), meta.seed);
    let mut replay = Replay::new(config.pilot()?);
    let (mut digest, mut seen, mut states) = (Digest::default(), States::default(), Vec::new());
    let (mut ticks, mut different, mut first) = (0_u64, 0_u64, None);
    let mut modes: BTreeMap<&str, u64> = BTreeMap::new();
    for entry in reader.by_ref() {
        match entry? {
            Entry::Configuration(found) => {
                let config = Config::from_toml(&found.toml)?;
                replay.configuration(found.number, config.pilot()?);
            }
            Entry::Tick(tick) => {
                let output = replay.tick(&tick)?;
                if !tick.is_output(&output) {
                    different += 1;
                    first.get_or_insert_with(|| {
                        let fields = tick.differences(&output).into_iter();
                        let fields: Vec<_> = fields.map(|it| it.to_string()).collect();
                        (tick.index, fields)
                    });
                }
                digest.add(&tick);
                seen.tick(&tick);
                if ticks % EVERY == 0 {
                    states.push(seen.state(&tick));
                }
                ticks += 1;
                *modes.entry(tick.output.mode.name()).or_default() += 1;
            }
            _ => {}
        }
    }
    crate::session::reply(&json!({
        "bytes": bytes,
        "software": software,
        "seed": seed,
        "ticks": ticks,
        "different": different,
        "first": first,
        "finished": reader.ending == Some(Ending::Finished),
        "digest": digest.to_string(),
        "modes": modes,
        "setup": top_view::setup(1, &config),
        "states": states,
    }))
}
