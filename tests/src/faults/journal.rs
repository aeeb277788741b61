//! What the processes themselves write down: their logs, followed line by line.

use serde_json::Value;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// A fragment's name within a run: who recorded it, under which session, in which episode, where.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Id {
    /// Actor.
    pub actor: String,
    /// Session of the learner.
    pub session: u64,
    /// Episode.
    pub episode: u64,
    /// Place in it.
    pub sequence: u64,
}

impl std::fmt::Display for Id {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { actor, session, episode, sequence } = self;
        write!(f, "fragment {sequence} of episode {episode} by {actor} under session {session}")
    }
}

/// A line that matters.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Entry {
    /// The learner has it and is about to say so.
    Accepted {
        /// The fragment.
        id: Id,
        /// Its agent-decisions.
        decisions: u64,
        /// Version of the policy that acted.
        policy_version: u64,
    },
    /// The learner did not keep it.
    Declined {
        /// The fragment.
        id: Id,
        /// Why.
        outcome: String,
    },
    /// It is in the round of this update.
    TrainedOn {
        /// The fragment.
        id: Id,
        /// The update.
        update: u64,
    },
    /// It left the buffer otherwise.
    Dropped {
        /// The fragment.
        id: Id,
        /// Why.
        reason: String,
    },
    /// An actor was told what became of it.
    Acknowledged {
        /// The fragment.
        id: Id,
        /// What.
        outcome: String,
    },
    /// The learner complains of something that it survives.
    Complained {
        /// Its words.
        message: String,
    },
    /// A process panicked.
    Panicked {
        /// Its words.
        line: String,
    },
}

/// Follows one log.
#[derive(Debug)]
pub(super) struct Journal {
    path: PathBuf,
    /// The actor whose log it is; the learner's names them itself.
    actor: Option<String>,
    file: Option<File>,
    /// The beginning of a line that is not whole yet.
    rest: Vec<u8>,
}

impl Journal {
    pub(super) fn new(path: &Path, actor: Option<&str>) -> Self {
        Self { path: path.to_owned(), actor: actor.map(str::to_owned), file: None, rest: Vec::new() }
    }

    /// The entries since the last call.
    pub(super) fn read(&mut self) -> Vec<Entry> {
        if self.file.is_none() {
            self.file = File::open(&self.path).ok();
        }
        let Some(file) = &mut self.file else { return Vec::new() };
        file.read_to_end(&mut self.rest).unwrap();
        let whole = self.rest.iter().rposition(|&byte| byte == b'\n').map_or(0, |at| at + 1);
        let lines: Vec<u8> = self.rest.drain(..whole).collect();
        let text = String::from_utf8_lossy(&lines);
        text.lines().filter_map(|line| entry(line, self.actor.as_deref())).collect()
    }

    /// The last lines, for a person.
    pub(super) fn tail(&self, lines: usize) -> String {
        let mut text = String::new();
        if let Ok(mut file) = File::open(&self.path) {
            let length = file.metadata().map_or(0, |metadata| metadata.len());
            let mut bytes = Vec::new();
            let _ = file.seek(SeekFrom::Start(length.saturating_sub(64 * 1024)));
            let _ = file.read_to_end(&mut bytes);
            let all = String::from_utf8_lossy(&bytes);
            let shown: Vec<&str> = all.lines().filter(|line| !line.contains("::fragments")).collect();
            let from = shown.len().saturating_sub(lines);
            text = shown[from..].join("\n");
        }
        format!("--- {}\n{text}\n", self.path.display())
    }
}

fn entry(line: &str, actor: Option<&str>) -> Option<Entry> {
    if !line.contains("::fragments\"") {
        if line.contains("\"level\":\"ERROR\"") {
            let value: Value = serde_json::from_str(line).ok()?;
            return Some(Entry::Complained { message: value["fields"]["message"].as_str()?.to_owned() });
        }
        return line.contains("panicked").then(|| Entry::Panicked { line: line.to_owned() });
    }
    let value: Value = serde_json::from_str(line).ok()?;
    let fields = &value["fields"];
    let id = Id {
        actor: fields["actor"].as_str().or(actor)?.to_owned(),
        session: fields["session"].as_u64()?,
        episode: fields["episode"].as_u64()?,
        sequence: fields["sequence"].as_u64()?,
    };
    let text = |name: &str| fields[name].as_str().map(str::to_owned);
    Some(match fields["message"].as_str()? {
        "fragment accepted" => Entry::Accepted {
            id,
            decisions: fields["decisions"].as_u64()?,
            policy_version: fields["policy_version"].as_u64()?,
        },
        "fragment declined" => Entry::Declined { id, outcome: text("outcome")? },
        "fragment trained on" => Entry::TrainedOn { id, update: fields["update"].as_u64()? },
        "fragment dropped" => Entry::Dropped { id, reason: text("reason")? },
        "fragment acknowledged" => Entry::Acknowledged { id, outcome: text("outcome")? },
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    #[test]
    fn a_line_counts_once_it_is_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        let mut journal = Journal::new(&path, None);
        assert_eq!(journal.read(), []);
        let line = r#"{"fields":{"message":"fragment trained on","actor":"a","session":7,"episode":3,"sequence":1,"update":9},"target":"cross_learner::fragments"}"#;
        let mut file = File::create(&path).unwrap();
        write!(file, "{}", &line[..40]).unwrap();
        assert_eq!(journal.read(), []);
        writeln!(file, "{}\nother words", &line[40..]).unwrap();
        let id = Id { actor: "a".to_owned(), session: 7, episode: 3, sequence: 1 };
        assert_eq!(journal.read(), [Entry::TrainedOn { id, update: 9 }]);
        writeln!(file, "thread 'main' panicked at here").unwrap();
        assert!(matches!(journal.read()[..], [Entry::Panicked { .. }]));
    }
}
