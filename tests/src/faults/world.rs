//! The cluster under test: one learner and its actors as real processes, kept running by supervisors, each in its own network
//! namespace, and everything that is seen of them.

use super::Broken;
use super::clock::Clock;
use super::disk::Disk;
use super::invariants::{Invariants, Look};
use super::journal::{Entry, Journal};
use super::launch::{Launch, PORT, RELAY_PORT, log};
use super::net::Net;
use super::observe::{self, Seen, Watch};
use super::recovery::{Flow, Over};
use super::relay::Relay;
use super::supervisor::{Exit, Service};
use cross_proto::v1::TrainingStatus;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Between two looks.
const STEP: Duration = Duration::from_millis(100);
const STATUS_EVERY: Duration = Duration::from_millis(500);
const CHECKPOINTS_EVERY: Duration = Duration::from_secs(2);

/// Ten seconds' decisions, twenty to an episode; updates of five episodes and a fraction of a second.
pub const CONFIG: &str = r#"
scenarios = ["grid4x4"]
[env]
episode_seconds = 200
[model]
hidden = 16
latent = 8
heads = 2
clusters = 2
experts = 2
top_k = 1
[ppo]
round_steps = 100
epochs = 1
sequence_steps = 10
minibatch_decisions = 256
[actor]
fragment_steps = 10
"#;

/// What kind of world.
#[derive(Debug, Clone)]
pub struct Setting {
    /// Number of actors.
    pub actors: usize,
    /// Updates at which training is complete.
    pub updates: u64,
    /// Configuration, without `updates`.
    pub config: String,
    /// Whether processes write their journals and go by clocks that can be set; without, they run as a user runs them.
    pub instrumented: bool,
    /// How many times longer than usual things may take before they count as broken.
    pub patience: u32,
}

/// The cluster; ended, with all that belongs to it, when dropped.
pub struct World {
    // In the order in which they have to go.
    pub(super) learner: Service,
    pub(super) actors: Vec<Service>,
    pub(super) twin: Option<Service>,
    pub(super) relay: Relay,
    pub(super) disk: Disk,
    pub(super) net: Net,
    /// The learner's, then the actors'.
    pub(super) clocks: Vec<Clock>,
    pub(super) invariants: Invariants,
    pub(super) watch: Watch,
    /// Ends of processes since somebody last took them.
    pub(super) exits: Vec<Exit>,
    /// Whether a process may end by itself at the moment.
    pub(super) lenient: bool,
    /// Whether there is a target that the run reaches, and everybody ends.
    ending: bool,
    /// Complaints of the learner since somebody last took them.
    pub(super) complaints: Vec<String>,
    pub(super) flow: Flow,
    status: Option<TrainingStatus>,
    processes: Vec<Seen>,
    journals: Vec<Journal>,
    setting: Setting,
    next_status: Instant,
    next_checkpoints: Instant,
    directory: tempfile::TempDir,
}

impl World {
    /// Builds the network and starts everything.
    #[must_use]
    pub fn new(setting: Setting) -> Self {
        let directory = tempfile::Builder::new().prefix("cross-faults-").tempdir().unwrap();
        let (root, marker) = (directory.path().to_owned(), directory.path().display().to_string());
        let net = Net::new(setting.actors);
        net.enter();
        let disk = Disk::mount(&root.join("disk"));
        for folder in ["logs", "clocks", "tmp"] {
            std::fs::create_dir(root.join(folder)).unwrap();
        }
        let names = std::iter::once("learner".to_owned()).chain((0..setting.actors).map(actor_name));
        let clocks: Vec<Clock> = names.clone().map(|name| Clock::new(&root.join("clocks"), &name)).collect();
        let journals = names
            .enumerate()
            .map(|(n, name)| Journal::new(&log(&root, &name), (n > 0).then_some(name.as_str())))
            .collect();
        write_config(&root, &setting.config, setting.updates);
        let launch = Launch { root, marker, instrumented: setting.instrumented };
        let learner = Service::new("learner", launch.learner(net.learner(), clocks[0].clone()));
        let actors = (0..setting.actors)
            .map(|n| {
                let port = if n + 1 == setting.actors { RELAY_PORT } else { PORT };
                let start = launch.actor(&net, n, port, &actor_name(n), clocks[n + 1].clone());
                Service::new(&actor_name(n), start)
            })
            .collect();
        let now = Instant::now();
        let relay = Relay::start(RELAY_PORT, &format!("127.0.0.1:{PORT}"));
        Self {
            learner,
            actors,
            twin: None,
            relay,
            disk,
            net,
            clocks,
            invariants: Invariants::default(),
            watch: Watch::new(&format!("127.0.0.1:{PORT}")),
            exits: Vec::new(),
            lenient: false,
            ending: false,
            complaints: Vec::new(),
            flow: Flow::default(),
            status: None,
            processes: Vec::new(),
            journals,
            setting,
            next_status: now,
            next_checkpoints: now,
            directory,
        }
    }

    /// The run directory.
    #[must_use]
    pub fn run(&self) -> PathBuf {
        self.directory.path().join("disk/run")
    }

    /// What marks its processes.
    #[must_use]
    pub fn marker(&self) -> String {
        self.directory.path().display().to_string()
    }

    /// The learner's address in its namespace.
    pub(super) fn address() -> String {
        format!("127.0.0.1:{PORT}")
    }

    /// The learner's status when it was last asked; none if it did not answer.
    pub(super) fn status(&self) -> Option<&TrainingStatus> {
        self.status.as_ref()
    }

    /// The process table when it was last looked at.
    #[must_use]
    pub fn processes(&self) -> &[Seen] {
        &self.processes
    }

    /// The newest SUMO of an actor.
    pub(super) fn sumo(&self, actor: usize) -> Option<i32> {
        let owner = self.actors[actor].pid()?;
        let own = |seen: &&Seen| seen.parent == owner && seen.found.program() == "sumo";
        self.processes.iter().filter(own).map(|seen| seen.found.pid).max()
    }

    /// Starts a second actor under the id of another, in the same place.
    pub(super) fn start_twin(&mut self, n: usize) {
        let launch = Launch {
            root: self.directory.path().to_owned(),
            marker: self.marker(),
            instrumented: self.setting.instrumented,
        };
        let name = format!("twin-of-{}", actor_name(n));
        let path = log(self.directory.path(), &name);
        if !path.exists() {
            self.journals.push(Journal::new(&path, Some(&actor_name(n))));
        }
        let start = launch.actor(&self.net, n, PORT, &name, self.clocks[n + 1].clone());
        let mut twin = Service::new(&name, start);
        let _ = twin.look();
        twin.hold(true);
        self.twin = Some(twin);
    }

    /// How many times longer than usual things may take here.
    pub(super) fn patience(&self) -> u32 {
        self.setting.patience
    }

    /// Has the next learner train up to this update, at which all processes end.
    pub(super) fn train_up_to(&mut self, updates: u64) {
        self.ending = true;
        self.setting.updates = updates;
        write_config(self.directory.path(), &self.setting.config, updates);
    }

    /// One look at everything, and a short rest.
    ///
    /// # Errors
    /// An invariant that does not hold.
    pub fn step(&mut self) -> Result<(), Broken> {
        let now = Instant::now();
        let due = now >= self.next_status;
        if due {
            self.next_status = now + STATUS_EVERY;
            self.status = self.watch.status();
            self.processes = observe::processes(&self.marker());
        }
        let looked = now >= self.next_checkpoints;
        if looked {
            self.next_checkpoints = now + CHECKPOINTS_EVERY;
        }
        // Ends before journals: what a process wrote before its end is then there to be read.
        let ended = self.look_after_services();
        let entries: Vec<Entry> = self.journals.iter_mut().flat_map(Journal::read).collect();
        self.flow.add(now, &entries);
        self.complaints.extend(entries.iter().filter_map(|entry| match entry {
            Entry::Complained { message } => Some(message.clone()),
            _ => None,
        }));
        let services = self.actors.iter().chain(&self.twin);
        let actors: Vec<i32> = services.filter_map(Service::pid).collect();
        let run = self.run();
        let look = Look {
            now,
            status: self.status.as_ref().filter(|_| due),
            entries: &entries,
            // A learner that has just ended is still in the table.
            processes: due.then_some(self.processes.as_slice()),
            actors: &actors,
            learner: self.learner.pid(),
            run: looked.then_some(run.as_path()),
            patience: self.setting.patience,
        };
        self.invariants.check(&look)?;
        if ended {
            self.invariants.look_at_checkpoints(&run)?;
            self.invariants.learner_ended();
            self.status = None;
        }
        if let Some(exit) = self.exits.iter().find(|exit| !self.lenient && exit.by_itself(self.ending)) {
            return Err(Broken::new("no process ends by itself", exit.to_string()));
        }
        std::thread::sleep(STEP.saturating_sub(now.elapsed()));
        Ok(())
    }

    /// Starts and reaps; whether the learner has ended.
    fn look_after_services(&mut self) -> bool {
        let learner = self.learner.look();
        let ended = learner.is_some();
        let actors = self.actors.iter_mut().chain(&mut self.twin);
        self.exits.extend(learner.into_iter().chain(actors.filter_map(Service::look)));
        ended
    }

    /// Goes on for a while.
    ///
    /// # Errors
    /// As [`World::step`].
    pub fn go_on(&mut self, time: Duration) -> Result<(), Broken> {
        let end = Instant::now() + time;
        while Instant::now() < end {
            self.step()?;
        }
        Ok(())
    }

    /// Goes on until there is something to return, for so many seconds and as many times longer as the setting's patience.
    ///
    /// # Errors
    /// As [`World::step`], or if nothing came in time.
    pub(super) fn until<T>(
        &mut self,
        what: &'static str,
        seconds: u64,
        mut look: impl FnMut(&mut Self) -> Option<T>,
    ) -> Result<T, Broken> {
        let seconds = seconds * u64::from(self.setting.patience);
        let end = Instant::now() + Duration::from_secs(seconds);
        loop {
            if let Some(found) = look(self) {
                return Ok(found);
            }
            if Instant::now() >= end {
                return Err(Broken::new(
                    "the suite goes on",
                    format!("waited {seconds} s in vain for {what}"),
                ));
            }
            self.step()?;
        }
    }

    /// Goes on while nothing is broken, to learn what throughput is usual.
    ///
    /// # Errors
    /// As [`World::step`].
    pub(super) fn undisturbed(&mut self, time: Duration) -> Result<(), Broken> {
        let end = Instant::now() + time;
        while Instant::now() < end {
            self.step()?;
            self.flow.undisturbed(Instant::now());
        }
        Ok(())
    }

    /// Waits until throughput is back; how long that took.
    ///
    /// # Errors
    /// As [`World::step`], or if it never came back.
    pub(super) fn recover(&mut self, over: &Over, seconds: u64) -> Result<Duration, Broken> {
        let end = Instant::now() + Duration::from_secs(seconds) * self.setting.patience;
        loop {
            self.step()?;
            let now = Instant::now();
            if let Some(took) = self.flow.back(over, now) {
                return Ok(took);
            }
            if now >= end {
                return Err(Broken::new("throughput comes back", self.flow.missing(over, now)));
            }
        }
    }

    /// The ends of all logs, for a person.
    #[must_use]
    pub fn tails(&self, lines: usize) -> String {
        self.journals.iter().map(|journal| journal.tail(lines)).collect()
    }

    /// Leaves the logs where they are when the world ends; the folder.
    #[must_use]
    pub fn keep_logs(&self) -> PathBuf {
        let kept = std::env::temp_dir().join(format!("cross-faults-logs-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&kept);
        // Best effort: it is for a person who looks for the cause of what has been reported already.
        let _ = std::fs::rename(self.directory.path().join("logs"), &kept);
        kept
    }
}

/// Name of an actor.
pub(super) fn actor_name(n: usize) -> String {
    format!("actor-{n}")
}

fn write_config(root: &Path, config: &str, updates: u64) {
    std::fs::write(root.join("config.toml"), format!("updates = {updates}\n{config}")).unwrap();
}
