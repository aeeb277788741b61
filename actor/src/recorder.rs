//! From single steps to fragments.
//!
//! ```text
//!   begin_fragment ─ decide ─ reward ─ decide ─ reward ─ ... ─ finish_fragment ─ begin_fragment ─ ...
//!                    └──── one step ──┘                        └ the observation after the last step
//! ```

use cross_model::Decision;
use cross_sim::trajectory::{Fragment, FragmentEnd, FragmentId, Observation, RecurrentState};

/// What all fragments of an episode share.
#[derive(Debug, Clone)]
pub struct EpisodeHeader {
    /// Id of this actor.
    pub actor: String,
    /// Session under which the episode was assigned.
    pub session_epoch: u64,
    /// Number of the episode.
    pub episode: u64,
    /// Scenario name.
    pub scenario: String,
    /// Hash of its layout.
    pub layout_hash: String,
}

/// Collects the steps of one episode and cuts them into fragments.
#[derive(Debug)]
pub struct Recorder {
    header: EpisodeHeader,
    fragment_steps: u32,
    /// Sequence number of the fragment that is being recorded.
    sequence: u32,
    /// Steps of the episode that lie in finished fragments.
    finished: u32,
    open: Open,
}

/// The fragment that is being recorded.
#[derive(Debug, Default)]
struct Open {
    policy_version: u64,
    recurrent: RecurrentState,
    steps: u32,
    counts: Vec<u16>,
    phases: Vec<u8>,
    actions: Vec<u8>,
    log_probs: Vec<f32>,
    rewards: Vec<f32>,
}

impl Recorder {
    /// Starts to record an episode in fragments of at most `fragment_steps` steps.
    #[must_use]
    pub fn new(header: EpisodeHeader, fragment_steps: u32) -> Self {
        Self {
            header,
            fragment_steps: fragment_steps.max(1),
            sequence: 0,
            finished: 0,
            open: Open::default(),
        }
    }

    /// Opens a fragment of the behaviour policy `policy_version`, whose recurrent state before the next step is
    /// `recurrent`.
    ///
    /// At the episode's start that state is zero by definition and is not kept, so that the wire need not carry it.
    pub fn begin_fragment(&mut self, policy_version: u64, recurrent: RecurrentState) {
        let recurrent = if self.finished == 0 { RecurrentState::default() } else { recurrent };
        self.open = Open { policy_version, recurrent, ..Open::default() };
    }

    /// Records what was seen and what was decided on it.
    pub fn decide(&mut self, seen: &Observation, decision: &Decision) {
        self.open.see(seen);
        self.open.actions.extend_from_slice(&decision.actions);
        self.open.log_probs.extend_from_slice(&decision.log_probs);
    }

    /// Records the rewards of that decision, which completes the step.
    pub fn reward(&mut self, rewards: &[f32]) {
        self.open.rewards.extend_from_slice(rewards);
        self.open.steps += 1;
    }

    /// True when the open fragment holds as many steps as it may.
    #[must_use]
    pub fn is_full(&self) -> bool {
        self.open.steps >= self.fragment_steps
    }

    /// True when the open fragment holds a step that would be lost with it.
    #[must_use]
    pub fn is_dirty(&self) -> bool {
        self.open.steps > 0
    }

    /// Steps of the episode so far.
    #[must_use]
    pub fn steps(&self) -> u32 {
        self.finished + self.open.steps
    }

    /// Closes the open fragment with `last`, what was seen after its last step.
    ///
    /// A new one has to be begun before the next step.
    pub fn finish_fragment(&mut self, last: &Observation, end: FragmentEnd) -> Fragment {
        let mut open = std::mem::take(&mut self.open);
        open.see(last);
        let fragment = Fragment {
            id: FragmentId {
                actor: self.header.actor.clone(),
                session_epoch: self.header.session_epoch,
                episode: self.header.episode,
                sequence: self.sequence,
            },
            scenario: self.header.scenario.clone(),
            layout_hash: self.header.layout_hash.clone(),
            policy_version: open.policy_version,
            first_step: self.finished,
            steps: open.steps,
            counts: open.counts,
            phases: open.phases,
            actions: open.actions,
            log_probs: open.log_probs,
            rewards: open.rewards,
            recurrent: open.recurrent,
            end,
        };
        self.sequence += 1;
        self.finished += fragment.steps;
        fragment
    }
}

impl Open {
    fn see(&mut self, observation: &Observation) {
        self.counts.extend_from_slice(&observation.counts);
        self.phases.extend_from_slice(&observation.phases);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AGENTS: usize = 2;

    fn header() -> EpisodeHeader {
        EpisodeHeader {
            actor: "a".into(),
            session_epoch: 9,
            episode: 4,
            scenario: "grid".into(),
            layout_hash: "h".into(),
        }
    }

    /// The observation at a step: three counts that tell the step apart.
    fn seen(step: u16) -> Observation {
        Observation { counts: vec![step, step + 100, step + 200], phases: vec![(step % 8) as u8; AGENTS] }
    }

    fn record_step(recorder: &mut Recorder, step: u16) {
        let decision = Decision { actions: vec![1; AGENTS], log_probs: vec![-0.5; AGENTS] };
        recorder.decide(&seen(step), &decision);
        recorder.reward(&[-f32::from(step); AGENTS]);
    }

    fn state(value: f32) -> RecurrentState {
        RecurrentState { actor: vec![value; 4], critic: vec![-value; 4] }
    }

    /// An episode of five steps in fragments of two.
    fn episode() -> Vec<Fragment> {
        let mut recorder = Recorder::new(header(), 2);
        let mut fragments = Vec::new();
        recorder.begin_fragment(10, state(7.0));
        for step in 0..5 {
            record_step(&mut recorder, step);
            let end = if step == 4 { FragmentEnd::Truncated } else { FragmentEnd::Continues };
            if recorder.is_full() || end != FragmentEnd::Continues {
                fragments.push(recorder.finish_fragment(&seen(step + 1), end));
                recorder.begin_fragment(u64::from(step) + 11, state(f32::from(step)));
            }
        }
        fragments
    }

    #[test]
    fn shapes_are_t_plus_one_observations_and_t_of_the_rest() {
        for fragment in episode() {
            let steps = fragment.steps as usize;
            assert_eq!(fragment.counts.len(), (steps + 1) * 3);
            assert_eq!(fragment.phases.len(), (steps + 1) * AGENTS);
            assert_eq!(fragment.actions.len(), steps * AGENTS);
            assert_eq!(fragment.log_probs.len(), steps * AGENTS);
            assert_eq!(fragment.rewards.len(), steps * AGENTS);
        }
    }

    #[test]
    fn fragments_follow_each_other_without_a_gap() {
        let fragments = episode();
        let starts: Vec<_> = fragments.iter().map(|f| (f.id.sequence, f.first_step, f.steps)).collect();
        assert_eq!(starts, [(0, 0, 2), (1, 2, 2), (2, 4, 1)]);
        let ends: Vec<_> = fragments.iter().map(|f| f.end).collect();
        assert_eq!(ends, [FragmentEnd::Continues, FragmentEnd::Continues, FragmentEnd::Truncated]);
        for pair in fragments.windows(2) {
            // The last observation of one is the first of the next: both are needed, one to bootstrap, one to train.
            assert_eq!(pair[0].counts[pair[0].counts.len() - 3..], pair[1].counts[..3]);
        }
    }

    #[test]
    fn recurrent_state_is_kept_exactly_for_continuations() {
        let fragments = episode();
        assert_eq!(fragments[0].recurrent, RecurrentState::default());
        assert_eq!(fragments[1].recurrent, state(1.0));
        assert_eq!(fragments[2].recurrent, state(3.0));
        let versions: Vec<_> = fragments.iter().map(|f| f.policy_version).collect();
        assert_eq!(versions, [10, 12, 14]);
    }

    #[test]
    fn a_fragment_is_dirty_only_while_it_holds_steps() {
        let mut recorder = Recorder::new(header(), 2);
        recorder.begin_fragment(1, RecurrentState::default());
        assert!(!recorder.is_dirty());
        record_step(&mut recorder, 0);
        assert!(recorder.is_dirty() && !recorder.is_full());
        record_step(&mut recorder, 1);
        assert!(recorder.is_full());
        recorder.finish_fragment(&seen(2), FragmentEnd::Continues);
        assert!(!recorder.is_dirty());
        assert_eq!(recorder.steps(), 2);
    }
}
