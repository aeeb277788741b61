//! Random orders of events against a model of actors: what must hold whatever happens, and that training always goes on.

use super::tests::{EPISODE, EPOCH, fragment, settings};
use super::*;
use cross_sim::trajectory::{Fragment, FragmentId};
use proptest::prelude::*;
use std::collections::HashSet;
use std::time::Duration;

/// An actor as the protocol allows it to be.
#[derive(Debug, Default)]
struct SimulatedActor {
    stream: Option<u64>,
    /// Waits for every acknowledgement before it asks for the next episode.
    patient: bool,
    /// Episode, scenario, next step, next sequence.
    episode: Option<(u64, usize, u32, u32)>,
    requested: bool,
    unacked: Vec<Fragment>,
}

struct World {
    admission: Admission,
    actors: Vec<SimulatedActor>,
    now: Duration,
    next_stream: u64,
    /// Fragments of the update in progress.
    in_training: Option<Vec<FragmentId>>,
    trained: HashSet<FragmentId>,
    trained_fragments: u64,
    updates: u64,
    steps: u32,
}

impl World {
    fn new(settings: Settings, actors: usize, patient: bool) -> Self {
        let steps = settings.fragment_steps;
        let mut world = Self {
            admission: Admission::new(settings, 1, Progress::default()),
            actors: Vec::new(),
            now: Duration::ZERO,
            next_stream: 1,
            in_training: None,
            trained: HashSet::new(),
            trained_fragments: 0,
            updates: 0,
            steps,
        };
        for i in 0..actors {
            world
                .actors
                .push(SimulatedActor { patient: patient ^ (i % 3 == 2), ..SimulatedActor::default() });
            world.start(i);
        }
        world
    }

    fn name(i: usize) -> String {
        format!("actor-{i}")
    }

    /// A new process under the same id.
    fn start(&mut self, i: usize) {
        let commands = self.admission.join(self.now, &Self::name(i), &[]);
        let patient = self.actors[i].patient;
        self.actors[i] = SimulatedActor { patient, ..SimulatedActor::default() };
        if let Ok(commands) = commands {
            self.obey(commands);
            self.connect(i);
        }
    }

    fn connect(&mut self, i: usize) {
        let stream = self.next_stream;
        self.next_stream += 1;
        if let Ok(commands) = self.admission.hello(self.now, StreamId(stream), &Self::name(i), EPOCH) {
            self.actors[i].stream = Some(stream);
            self.actors[i].requested = false;
            self.obey(commands);
            for fragment in self.actors[i].unacked.clone() {
                let commands = self.admission.offer(self.now, StreamId(stream), fragment);
                self.obey(commands);
            }
        }
    }

    fn cut(&mut self, i: usize) {
        if let Some(stream) = self.actors[i].stream.take() {
            let commands = self.admission.disconnected(StreamId(stream));
            self.obey(commands);
        }
    }

    /// The actor does the next thing that it may do.
    fn advance(&mut self, i: usize) {
        let Some(stream) = self.actors[i].stream else { return self.reconnect(i) };
        let limit = self.admission.settings().unacked_fragments;
        let actor = &mut self.actors[i];
        let commands = if let Some((episode, scenario, step, sequence)) = actor.episode {
            if actor.unacked.len() >= limit {
                self.admission.heartbeat(self.now, StreamId(stream))
            } else {
                let steps = self.steps.min(EPISODE - step);
                let name = self.admission.settings().scenarios[scenario].name.clone();
                let mut next = fragment(&Self::name(i), episode, sequence, &name, step, steps);
                next.policy_version = self.admission.policy_version();
                actor.unacked.push(next.clone());
                let done = step + steps == EPISODE;
                actor.episode = (!done).then_some((episode, scenario, step + steps, sequence + 1));
                self.admission.offer(self.now, StreamId(stream), next)
            }
        } else if !actor.requested && (actor.unacked.is_empty() || !actor.patient) {
            actor.requested = true;
            self.admission.request_episode(self.now, StreamId(stream))
        } else {
            self.admission.heartbeat(self.now, StreamId(stream))
        };
        self.obey(commands);
    }

    fn reconnect(&mut self, i: usize) {
        self.connect(i);
        if self.actors[i].stream.is_none() {
            self.start(i);
        }
    }

    fn finish_update(&mut self) {
        if let Some(round) = self.in_training.take() {
            self.trained_fragments += round.len() as u64;
            for id in round {
                assert!(self.trained.insert(id.clone()), "trained twice on {id:?}");
            }
            self.updates += 1;
            let version = self.admission.policy_version() + 1;
            let commands = self.admission.updated(version);
            assert_eq!(self.admission.policy_version(), version);
            self.obey(commands);
        }
    }

    fn obey(&mut self, commands: Vec<Command>) {
        for command in commands {
            match command {
                Command::Acknowledge { stream, episode, sequence, .. } => {
                    let actor =
                        self.actors.iter_mut().find(|a| a.stream == Some(stream.0)).expect("a live stream");
                    let before = actor.unacked.len();
                    actor.unacked.retain(|f| (f.id.episode, f.id.sequence) != (episode, sequence));
                    assert_eq!(actor.unacked.len() + 1, before, "acknowledged what was not sent");
                }
                Command::Assign { stream, assignment } => {
                    let actor =
                        self.actors.iter_mut().find(|a| a.stream == Some(stream.0)).expect("a live stream");
                    assert!(actor.requested && actor.episode.is_none());
                    actor.requested = false;
                    actor.episode = Some((assignment.episode, assignment.scenario, 0, 0));
                }
                Command::Close { stream, reason } => {
                    let ok = matches!(reason, CloseReason::Replaced | CloseReason::LeaseEnded);
                    assert!(ok, "{reason:?}");
                    if let Some(actor) = self.actors.iter_mut().find(|a| a.stream == Some(stream.0)) {
                        actor.stream = None;
                    }
                }
                Command::Update(round) => {
                    assert!(self.in_training.is_none(), "two updates at once");
                    for scenario in &self.admission.settings().scenarios {
                        let steps: u32 = round
                            .fragments
                            .iter()
                            .filter(|f| f.scenario == scenario.name)
                            .map(|f| f.steps)
                            .sum();
                        assert!(u64::from(steps) >= self.admission.settings().round_steps);
                    }
                    assert!(round.lag.max <= self.admission.settings().max_policy_lag);
                    self.in_training = Some(round.fragments.iter().map(|f| f.id.clone()).collect());
                }
            }
        }
        self.check();
    }

    fn check(&self) {
        let scenarios = 0..self.admission.settings().scenarios.len();
        let limit = self.admission.hard_limit() + u64::from(self.steps);
        let mut accepted = 0;
        let mut dropped = 0;
        for scenario in scenarios {
            assert!(self.admission.buffered_steps(scenario) <= limit, "the buffer outgrew its bound");
            accepted += self.admission.offered(scenario, Outcome::Accepted);
            for reason in [Dropped::Stale, Dropped::Overflow, Dropped::Aborted] {
                dropped += self.admission.dropped(scenario, reason);
            }
        }
        let in_training = self.in_training.as_ref().map_or(0, Vec::len) as u64;
        let there = self.admission.inserted_fragments() as u64;
        let pending = accepted - self.trained_fragments - dropped;
        // Between the command and its execution here a round is in neither place.
        assert!(
            pending == there + in_training || self.admission.is_updating(),
            "an acknowledged fragment is lost"
        );
    }

    /// Everybody alive works in turn and updates end: the wanted number of updates must come.
    fn must_progress(&mut self, updates: u64) {
        let all: Vec<usize> = (0..self.actors.len()).collect();
        self.must_progress_with(&all, updates);
    }

    /// As [`must_progress`](Self::must_progress), with only these actors alive.
    fn must_progress_with(&mut self, alive: &[usize], updates: u64) {
        let target = self.updates + updates;
        for _ in 0..20_000 {
            if self.updates >= target {
                return;
            }
            for &i in alive {
                self.advance(i);
            }
            self.finish_update();
        }
        panic!("no progress: {:?}", self.admission);
    }
}

/// Settings over the whole range that the configuration allows, small enough to be quick.
fn any_settings() -> impl Strategy<Value = Settings> {
    (1usize..4, 1u64..80, 1u64..3, 1u32..=EPISODE, 1usize..5, 0u64..4, any::<bool>()).prop_map(
        |(scenarios, round_steps, rounds, fragment_steps, unacked, lag, serial)| {
            let round_steps = if serial { u64::from(EPISODE) * (1 + round_steps % 2) } else { round_steps };
            Settings {
                round_steps,
                buffered_steps: round_steps * rounds,
                fragment_steps,
                unacked_fragments: if serial { 1 } else { unacked },
                max_policy_lag: lag,
                serial,
                updates: u64::MAX,
                ..settings(&["x", "y", "z"][..scenarios])
            }
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn invariants_hold_in_any_order_of_events_and_training_goes_on(
        settings in any_settings(),
        actors in 1usize..5,
        patient in any::<bool>(),
        events in prop::collection::vec((0u8..20, 0usize..5), 0..400),
    ) {
        let actors = if settings.serial { 1 } else { actors };
        let mut world = World::new(settings, actors, patient);
        for (event, i) in events {
            let i = i % actors;
            match event {
                0 => world.cut(i),
                1 => world.start(i),
                2 => {
                    // The process dies and nobody starts it again for longer than the lease.
                    world.cut(i);
                    world.now += Duration::from_secs(31);
                    let commands = world.admission.tick(world.now);
                    world.obey(commands);
                }
                3 => {
                    if let (Some(stream), Some((episode, ..))) = (world.actors[i].stream, world.actors[i].episode.take()) {
                        let commands = world.admission.abort_episode(world.now, StreamId(stream), episode);
                        world.obey(commands);
                    }
                }
                4 => world.finish_update(),
                5 => world.admission.pause(),
                6 => {
                    let commands = world.admission.resume();
                    world.obey(commands);
                }
                _ => world.advance(i),
            }
        }
        let commands = world.admission.resume();
        world.obey(commands);
        world.must_progress(3);
    }

    #[test]
    fn one_actor_serves_many_scenarios(settings in any_settings(), patient in any::<bool>()) {
        World::new(settings, 1, patient).must_progress(5);
    }

    #[test]
    fn progress_survives_the_death_of_those_who_fed_a_scenario(
        settings in any_settings(),
        patient in any::<bool>(),
        work in 0usize..60,
        survivor in 0usize..4,
    ) {
        prop_assume!(!settings.serial);
        let mut world = World::new(settings, 4, patient);
        for _ in 0..work {
            for i in 0..4 {
                world.advance(i);
            }
        }
        for i in (0..4).filter(|&i| i != survivor) {
            world.cut(i);
        }
        world.now += Duration::from_secs(31);
        let alive = world.actors[survivor].stream.map(StreamId);
        if let Some(stream) = alive {
            let commands = world.admission.heartbeat(world.now, stream);
            world.obey(commands);
        }
        let commands = world.admission.tick(world.now);
        world.obey(commands);
        prop_assert_eq!(world.admission.actors(), 1);
        world.must_progress_with(&[survivor], 3);
    }
}
