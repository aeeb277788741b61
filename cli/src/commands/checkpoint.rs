//! `cross checkpoint`: what a run has saved.

use super::publish::publish;
use crate::failure::{Failure, OrBadInput, Outcome};
use crate::output;
use crate::saved::{Chosen, Saved};
use crate::train::run_dir::{RUNS, newest};
use clap::{Args, Subcommand};
use cross_learner::checkpoint::{MODEL_FILE, Metadata, reader};
use cross_model::Policy;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Lists, shows, exports, publishes and verifies the checkpoints of a run
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  cross checkpoint list                                of the newest run under runs/
  cross checkpoint list --run runs/paper-3 --json
  cross checkpoint show latest
  cross checkpoint export latest --out policy.safetensors
  cross checkpoint publish --last 5 --out my/policy    the mean of the five newest, with its description
  cross checkpoint verify 000100 --run runs/paper-3
  cross checkpoint list --run s3://bucket/paper-3      copies in an object store

An ID is a checkpoint's number as `list` shows it, `latest`, or the path of its directory, or its URL.")]
pub(crate) struct Checkpoint {
    #[command(subcommand)]
    command: Command,
    /// Run directory, or URL that checkpoints were copied to [default: the newest under runs/]
    #[arg(long, value_name = "DIR|URL", global = true)]
    run: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long, global = true)]
    json: bool,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Every checkpoint of the run, newest first
    List,
    /// What one is: updates, configuration, versions, tensors
    Show {
        /// Number, `latest`, path or URL
        id: String,
    },
    /// Writes one's policy to a file that `cross eval` and any safetensors reader take
    Export {
        /// Number, `latest`, path or URL
        id: String,
        /// File to write
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
    },
    /// Writes a policy to give away: weights and description, without what only training needs
    ///
    /// The weights may be the mean of several checkpoints'. Where traffic is chaotic, neighbouring checkpoints control it
    /// differently well, and a mean is less a matter of luck.
    /// What is written is taken by every --policy.
    Publish {
        /// Average the newest N checkpoints
        #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..))]
        last: u16,
        /// Folder to write `model.safetensors` and `metadata.json` into; older ones there are replaced
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
    },
    /// Compares one's files with their recorded sizes and hashes, and loads its networks
    Verify {
        /// Number, `latest`, path or URL
        id: String,
    },
}

impl Checkpoint {
    pub(crate) fn run(&self) -> Outcome<ExitCode> {
        match &self.command {
            Command::List => self.list()?,
            Command::Show { id } => self.show(&self.find(id)?)?,
            Command::Export { id, out } => self.export(&self.find(id)?, out)?,
            Command::Publish { last, out } => self.publish(*last, out)?,
            Command::Verify { id } => self.verify(&self.find(id)?)?,
        }
        Ok(ExitCode::SUCCESS)
    }

    fn saved(&self) -> Outcome<Saved> {
        let by_url = self.run.as_deref().map_or(Ok(None), Saved::by_url)?;
        by_url.map_or_else(|| self.run_directory().map(Saved::Disk), Ok)
    }

    fn run_directory(&self) -> Outcome<PathBuf> {
        match &self.run {
            Some(path) if path.is_dir() => Ok(path.clone()),
            Some(path) => Err(Failure::input(format!("there is no run directory {}", path.display()))),
            None => newest(Path::new(RUNS)).ok_or_else(|| {
                Failure::input(format!("there is no run under {RUNS}/ in this folder; go where you trained, or name one with --run DIR"))
            }),
        }
    }

    fn find(&self, id: &str) -> Outcome<Chosen> {
        if let Some(chosen) = Chosen::by_url(id)? {
            return Ok(chosen);
        }
        let as_path = Path::new(id);
        // An id is digits or `latest`; anything with a separator can only be a path.
        if as_path.components().count() > 1 && as_path.is_dir() {
            return Ok(Chosen::Disk(as_path.to_owned()));
        }
        self.saved()?.find(id)
    }

    fn list(&self) -> Outcome<()> {
        let saved = self.saved()?;
        let run = saved.path();
        let (entries, latest) = saved.list()?;
        if entries.is_empty() && matches!(saved, Saved::Store(_)) {
            // A store has no empty folders: nothing tells a run without checkpoints from an address that is none.
            return Err(Failure::input(format!(
                "{} holds no checkpoint; name the URL that was given to --checkpoints",
                run.display()
            )));
        }
        if self.json {
            let checkpoints: Vec<_> = entries
                .iter()
                .map(|entry| match &entry.metadata {
                    Ok(metadata) => serde_json::json!({
                        "id": entry.id,
                        "path": entry.path,
                        "latest": latest.as_ref() == Some(&entry.path),
                        "created": metadata.created,
                        "updates": metadata.updates,
                        "policy_version": metadata.policy_version,
                        "decisions": metadata.decisions,
                        "episodes": metadata.episodes,
                        "episode_return": metadata.episode_return,
                    }),
                    Err(error) => serde_json::json!({
                        "id": entry.id, "path": entry.path, "problem": error.to_string()
                    }),
                })
                .collect();
            return output::json(&serde_json::json!({ "run": run, "checkpoints": checkpoints }));
        }
        if entries.is_empty() {
            return output::text(&format!("{} has no checkpoint yet", run.display()));
        }
        let mut text = String::new();
        for entry in &entries {
            let mark = if latest.as_ref() == Some(&entry.path) { "  latest" } else { "" };
            let line = match &entry.metadata {
                Ok(metadata) => {
                    let returns: Vec<_> = metadata
                        .episode_return
                        .iter()
                        .map(|(scenario, value)| format!("{scenario} return {value:.1}"))
                        .collect();
                    format!("{}  {} decisions  {}", metadata.created, metadata.decisions, returns.join(", "))
                }
                Err(error) => format!("not usable: {error}"),
            };
            let _ = writeln!(text, "{}  {line}{mark}", entry.id);
        }
        output::text(&text)
    }

    fn show(&self, chosen: &Chosen) -> Outcome<()> {
        let path = &chosen.path();
        let (metadata, model) = chosen.model()?;
        let tensors = reader::tensors_of(&model, &path.join(MODEL_FILE)).or_bad_input()?;
        if self.json {
            let tensors: Vec<_> = tensors
                .iter()
                .map(|tensor| {
                    serde_json::json!({ "name": tensor.name, "dtype": tensor.dtype, "shape": tensor.shape })
                })
                .collect();
            return output::json(
                &serde_json::json!({ "path": path, "metadata": metadata, "tensors": tensors }),
            );
        }
        let mut text = render(path, &metadata);
        let _ = writeln!(text, "  tensors");
        for tensor in &tensors {
            let _ = writeln!(text, "    {} {} {:?}", tensor.name, tensor.dtype, tensor.shape);
        }
        output::text(&text)
    }

    fn export(&self, chosen: &Chosen, out: &Path) -> Outcome<()> {
        let metadata = chosen.export(out)?;
        if self.json {
            return output::json(&serde_json::json!({
                "id": metadata.id, "out": out, "policy_version": metadata.policy_version
            }));
        }
        output::text(&format!("wrote the policy of checkpoint {} to {}", metadata.id, out.display()))
    }

    fn publish(&self, last: u16, out: &Path) -> Outcome<()> {
        let metadata = publish(&self.saved()?, usize::from(last), out)?;
        if self.json {
            return output::json(&serde_json::json!({
                "id": metadata.id, "averaged": metadata.averaged, "out": out, "policy_version": metadata.policy_version
            }));
        }
        let weights = match metadata.averaged.as_slice() {
            [] => format!("the policy of checkpoint {}", metadata.id),
            averaged => format!("the mean of checkpoints {}", averaged.join(", ")),
        };
        output::text(&format!("wrote {weights} to {}", out.display()))
    }

    fn verify(&self, chosen: &Chosen) -> Outcome<()> {
        let path = &chosen.path();
        let checkpoint = chosen.verify()?;
        let metadata = checkpoint.metadata;
        Policy::from_snapshot(&checkpoint.files.model).or_bad_input()?;
        if self.json {
            return output::json(&serde_json::json!({ "id": metadata.id, "path": path, "ok": true }));
        }
        output::text(&format!(
            "checkpoint {} is whole: {} files match their hashes, and the networks load",
            metadata.id,
            metadata.files.len()
        ))
    }
}

fn render(path: &Path, metadata: &Metadata) -> String {
    let mut text = format!("checkpoint {} in {}\n", metadata.id, path.display());
    for (label, value) in [
        ("run", metadata.run_id.clone()),
        ("created", metadata.created.clone()),
        ("updates", metadata.updates.to_string()),
        ("policy version", metadata.policy_version.to_string()),
        ("decisions", metadata.decisions.to_string()),
        ("episodes", metadata.episodes.to_string()),
        ("seed", metadata.seed.to_string()),
        ("config hash", metadata.config_hash.clone()),
        ("cross", metadata.versions.cross.clone()),
        ("sumo", metadata.versions.sumo.clone()),
        ("libtorch", metadata.versions.libtorch.clone()),
    ] {
        let _ = writeln!(text, "  {label:15} {value}");
    }
    if !metadata.averaged.is_empty() {
        let _ = writeln!(text, "  {:15} {}", "mean of", metadata.averaged.join(", "));
    }
    for (scenario, value) in &metadata.episode_return {
        let _ = writeln!(text, "  return {scenario}: {value:.2}");
    }
    text
}
