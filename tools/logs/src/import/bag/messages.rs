//! The messages of a bag, decoded as they are read.

use std::path::{Path, PathBuf};

use super::{
    cdr::{self, Fault, Value},
    definition::{Definition, short},
    seconds,
    wanted::{Entry, Row, Source, Wanted, message_error},
};
use crate::import::log::{ImportError, JITTER_NS};

/// What to do about a type without definition.
const CONVERT: &str = "convert the bag with `ros2 bag convert` to MCAP where the type is installed";

/// No clock shows a later time than this, of the year 2262, in ns: that of a time before 1970 is.
const LATEST_NS: u64 = i64::MAX as u64;

/// A topic as a file describes it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Topic<'a> {
    pub(super) name: &'a str,
    /// Its type, such as `geometry_msgs/msg/PoseStamped`.
    pub(super) kind: &'a str,
    /// How messages are encoded.
    pub(super) encoding: &'a str,
    /// The language of the definition of the type, and the definition.
    pub(super) definition: Option<(&'a str, &'a str)>,
}

/// The messages that a map wants, from all files of a bag.
pub(super) struct Messages {
    path: PathBuf,
    sources: Vec<Source>,
    topics: Vec<KnownTopic>,
    plans: Vec<Plan>,
    entries: Vec<Entry>,
}

struct KnownTopic {
    name: String,
    kind: String,
    messages: u64,
}

/// How the messages of a topic are read.
#[derive(PartialEq)]
struct Plan {
    topic: usize,
    definition: Definition,
}

impl Messages {
    pub(super) fn new(path: &Path, sources: Vec<Source>) -> Self {
        Self {
            path: path.to_owned(),
            sources,
            topics: Vec::new(),
            plans: Vec::new(),
            entries: Vec::new(),
        }
    }

    /// Takes the description of a topic; gives the number by which [`Self::message`] knows how its
    /// messages are read, or `None` if the map does not want it.
    pub(super) fn topic(&mut self, topic: &Topic<'_>) -> Result<Option<usize>, ImportError> {
        let kind = short(topic.kind);
        let wrong = |why: String| topic_error(&self.path, topic.name, &kind, &why);
        let known = self.topics.iter().position(|one| one.name == topic.name);
        let place = match known {
            Some(place) => place,
            None => {
                self.topics.push(KnownTopic {
                    name: topic.name.to_owned(),
                    kind: kind.clone(),
                    messages: 0,
                });
                self.topics.len() - 1
            }
        };
        let sources = self.sources.iter();
        let mut sources = sources.filter(|one| one.topic == topic.name).peekable();
        if sources.peek().is_none() {
            return Ok(None);
        }
        let other = &self.topics[place].kind;
        if *other != kind {
            return Err(wrong(format!(
                "it has messages of type {other} too: rename one of the two"
            )));
        }
        if topic.encoding != "cdr" {
            let encoding = topic.encoding;
            return Err(wrong(format!(
                "its encoding {encoding:?} is not read, only \"cdr\""
            )));
        }
        // Only the one language is read; the built-in definitions are in it.
        let (text, fix) = match topic.definition {
            Some(("ros2msg", text)) => (text, CONVERT.to_owned()),
            None | Some(("" | "unknown", _)) => ("", CONVERT.to_owned()),
            Some((language, _)) => (
                "",
                format!(
                    "its definition is in {language:?}, which is not read: publish it as a type that has \
                     a .msg file, or make a CSV file of it"
                ),
            ),
        };
        let definition =
            Definition::parse(&kind, text).map_err(|why| wrong(format!("{why}; {fix}")))?;
        for wanted in sources.flat_map(Source::wanted) {
            let Wanted { key, text, .. } = wanted;
            let checked = wanted.path.check(&definition, wanted.takes);
            checked.map_err(|why| wrong(format!("{key} in the map names {text:?}: {why}")))?;
        }
        let plan = Plan {
            topic: place,
            definition,
        };
        // Each file of a bag, and each publisher, describes the topic again.
        let known = self.plans.iter().position(|one| *one == plan);
        Ok(Some(known.unwrap_or_else(|| {
            self.plans.push(plan);
            self.plans.len() - 1
        })))
    }

    /// Takes a message.
    pub(super) fn message(
        &mut self,
        plan: usize,
        receive_ns: u64,
        bytes: &[u8],
    ) -> Result<(), ImportError> {
        let plan = &self.plans[plan];
        let topic = &mut self.topics[plan.topic];
        topic.messages += 1;
        let number = topic.messages;
        let wrong = |why: String| message_error(&self.path, &topic.name, number, receive_ns, &why);
        let failed = |fault: Fault| wrong(format!(" {fault}"));
        let message = cdr::decode(bytes, &plan.definition).map_err(failed)?;
        let sources = self.sources.iter_mut().enumerate();
        for (place, source) in sources.filter(|(_, one)| one.topic == topic.name) {
            let mut values = Vec::with_capacity(source.fields.len());
            for wanted in &mut source.fields {
                let found = wanted.find(&message).map_err(failed)?;
                values.push(found.map(Value::number));
            }
            let stamp_ns = match &mut source.stamp {
                None if receive_ns > LATEST_NS => {
                    return Err(wrong(
                        ": its time of reception is later than the year 2262: the recorder's clock was \
                         wrong; take a stamp of the messages in the map, or leave the message out, such as \
                         with `mcap filter --end-secs 9000000000`"
                            .to_owned(),
                    ));
                }
                None => receive_ns,
                Some(wanted) => {
                    // Without one, the message is about other bodies.
                    let Some(found) = wanted.find(&message).map_err(failed)? else {
                        continue;
                    };
                    stamp_ns(found)
                        .map_err(|fault| wrong(format!(": its {} {fault}", wanted.text)))?
                }
            };
            self.entries.push(Entry {
                source: place,
                number,
                // One that can't be right puts the message nowhere.
                receive_ns: if receive_ns > LATEST_NS {
                    stamp_ns
                } else {
                    receive_ns
                },
                stamp_ns,
                values,
            });
        }
        Ok(())
    }

    /// Orders all messages by their times. Fails if something that the map wants is missing, if the
    /// times of a source go backwards, or if two messages are farther apart than the longest gap.
    /// Returns how many were not in their order, by a little.
    pub(super) fn sort(&mut self, longest_gap_ns: u64) -> Result<u64, ImportError> {
        for source in &self.sources {
            self.check(source)?;
        }
        // A file is written in the order of reception, also by a recorder whose clock is wrong; of
        // several files the order may be another one.
        let mut disordered = self.check_order();
        if disordered.is_err() {
            self.entries.sort_by_key(|entry| entry.receive_ns);
            disordered = self.check_order();
        }
        let disordered = disordered?;
        self.entries.sort_by_key(|entry| entry.stamp_ns);
        self.check_gaps(longest_gap_ns)?;
        Ok(disordered)
    }

    /// The rows that the messages are, each with its time in ns since 1970.
    pub(super) fn rows(&self) -> impl Iterator<Item = (u64, Row<'_>)> {
        self.entries.iter().map(|entry| {
            let row = Row {
                path: &self.path,
                sources: &self.sources,
                entry,
            };
            (entry.stamp_ns, row)
        })
    }

    /// Fails if the bag does not have what a source wants.
    fn check(&self, source: &Source) -> Result<(), ImportError> {
        let topic = self.topics.iter().find(|one| one.name == source.topic);
        if topic.is_none_or(|topic| topic.messages == 0) {
            let topics = self.topics.iter();
            let topics = topics.map(|one| format!("{:?} ({})", one.name, one.kind));
            let what = match topic {
                Some(_) => "no messages on the topic",
                None => "no topic",
            };
            let (name, key, topics) = (&source.topic, source.key(), listed(topics));
            let why = format!(
                " has {what} {name:?}, which {key} in the map names; its topics are {topics}"
            );
            return Err(ImportError::file(&self.path, why));
        }
        let Some(wanted) = source.wanted().find(|wanted| !wanted.is_found) else {
            return Ok(());
        };
        let names = wanted.names.iter().map(|name| format!("{name:?}"));
        let (key, text, names) = (&wanted.key, &wanted.text, listed(names));
        let kind = topic.map_or("", |topic| &topic.kind);
        let why = format!(
            "no message has the element that {key} in the map names, {text:?}; there are {names}"
        );
        Err(topic_error(&self.path, &source.topic, kind, &why))
    }

    /// How many messages came after a later one of their source, by a little. Fails if the times of
    /// a source go backwards.
    fn check_order(&self) -> Result<u64, ImportError> {
        let mut disordered = 0;
        let mut last = vec![0; self.sources.len()];
        for entry in &self.entries {
            let last = &mut last[entry.source];
            if entry.stamp_ns + JITTER_NS < *last {
                let back = seconds(*last - entry.stamp_ns);
                let fault = format!(
                    "is {back} s before that of the message before: two nodes publish on the topic, or \
                     a clock was set; stamp = \"receive\" in the map takes the time of reception"
                );
                return Err(self.time_error(entry, &fault));
            }
            disordered += u64::from(entry.stamp_ns < *last);
            *last = entry.stamp_ns.max(*last);
        }
        Ok(disordered)
    }

    /// Fails if there is a gap between the messages of all sources.
    fn check_gaps(&self, longest_gap_ns: u64) -> Result<(), ImportError> {
        for (before, entry) in self.entries.iter().zip(self.entries.iter().skip(1)) {
            let gap_ns = entry.stamp_ns - before.stamp_ns;
            if gap_ns > longest_gap_ns {
                let gap = seconds(gap_ns);
                let fault = format!(
                    "is {gap} s after that of message {} of {:?}, the one before: if the two have other \
                     clocks, use stamp = \"receive\" in the map; if the bag has a gap, import a part of \
                     it or raise time.longest_gap_s",
                    before.number,
                    before.topic(&self.sources)
                );
                return Err(self.time_error(entry, &fault));
            }
        }
        Ok(())
    }

    fn time_error(&self, entry: &Entry, fault: &str) -> ImportError {
        let stamp = self.sources[entry.source].stamp.as_ref();
        let stamp = stamp.map_or("time of reception", |wanted| &wanted.text);
        entry.error(&self.path, &self.sources, &format!(": its {stamp} {fault}"))
    }
}

/// The error of a topic whose type can't be read, or has not the fields of the map.
fn topic_error(path: &Path, topic: &str, kind: &str, why: &str) -> ImportError {
    ImportError::file(path, format!(", topic {topic:?} of type {kind}: {why}"))
}

/// A time of a message in ns since 1970, or the reason why it can't be right.
fn stamp_ns(time: &Value<'_>) -> Result<u64, &'static str> {
    let part = |part| time.parts().get(part).map_or(0.0, Value::number) as i64;
    match (part(0), part(1)) {
        (0, 0) => Err(
            "is 0: its node does not set it; stamp = \"receive\" in the map takes the time of reception",
        ),
        (..0, _) => {
            Err("is before 1970: the message is damaged, or of another version of its type")
        }
        (_, 1_000_000_000..) => Err(
            "has more than a second of nanoseconds: the message is damaged, or of another version of \
                 its type",
        ),
        (seconds, nanoseconds) => Ok((seconds * 1_000_000_000 + nanoseconds).cast_unsigned()),
    }
}

fn listed(names: impl Iterator<Item = String>) -> String {
    let names: Vec<_> = names.collect();
    match names.is_empty() {
        true => "none".to_owned(),
        false => names.join(", "),
    }
}
