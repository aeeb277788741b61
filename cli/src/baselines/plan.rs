//! Which episodes make a table: scenarios, policies, seeds.

use super::store::Made;
use crate::evaluate;
use crate::failure::{Failure, OrBadInput, Outcome};
use crate::policy::PolicySpec;
use cross_config::EnvConfig;
use cross_sim::controller::{Controller, MaxPressure, RuleBased};
use cross_sim::layout::load_layout;
use cross_sim::scenario::{Scenario, ScenarioError};
use serde::Serialize;

/// The scenarios of the paper's result tables, in their order.
pub(crate) const SCENARIOS: [&str; 8] =
    ["grid4x4", "arterial4x4", "grid5x5", "jinan1", "jinan2", "jinan3", "hangzhou1", "hangzhou2"];

/// Seeds where nobody says how many. The traffic of `grid5x5` is chaotic: few seeds say little about it. Of rules that nobody
/// has published figures of, one seed has to do on the large scenarios, whose episodes are the long ones.
fn default_seeds(scenario: &str, policy: &PolicySpec) -> u32 {
    let published = policy
        .rule()
        .is_some_and(|rule| rule == RuleBased::FixedTime || RuleBased::MAX_PRESSURE_VARIANTS.contains(&rule));
    let large = SCENARIOS[2..].contains(&scenario);
    match scenario {
        "grid5x5" if published => 10,
        _ if large && !published => 1,
        _ => 3,
    }
}

/// Rules where nobody names any: all but the random one, which is nobody's baseline. `max-pressure` stands for the paper's
/// variant, which is one of those listed by its full name.
fn default_policies() -> Vec<PolicySpec> {
    RuleBased::ALL.into_iter().filter(|&rule| rule != RuleBased::Random).map(PolicySpec::Rule).collect()
}

/// A scenario with its policies and seeds.
#[derive(Debug)]
pub(crate) struct Subject {
    pub(crate) scenario: Scenario,
    /// Each once; no alias among them.
    pub(crate) policies: Vec<PolicySpec>,
    /// Seeds of every policy, if somebody said how many.
    seeds: Option<u32>,
    /// Vehicles that its demand defines.
    pub(crate) vehicles: u64,
    /// Hash of its intersections.
    pub(crate) layout_hash: String,
}

/// A scenario that cannot be used, with the remedy.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct Missing {
    pub(crate) scenario: String,
    pub(crate) reason: String,
}

/// Everything that is to be evaluated.
#[derive(Debug)]
pub(crate) struct Plan {
    pub(crate) subjects: Vec<Subject>,
    pub(crate) missing: Vec<Missing>,
    pub(crate) env: EnvConfig,
    pub(crate) sumo_version: String,
}

/// One episode.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Job<'p> {
    pub(crate) subject: &'p Subject,
    pub(crate) policy: &'p PolicySpec,
    pub(crate) seed: u32,
}

impl Plan {
    /// Loads what is asked for; empty lists ask for the usual. A scenario of the paper that was not imported is noted as
    /// missing; one that was named must be there.
    pub(crate) fn new(
        scenarios: &[String],
        policies: &[PolicySpec],
        seeds: Option<u32>,
        env: EnvConfig,
        sumo_version: String,
    ) -> Outcome<Self> {
        for policy in policies {
            same_clock(policy, &env)?;
        }
        let mut plan = Self { subjects: Vec::new(), missing: Vec::new(), env, sumo_version };
        let named = !scenarios.is_empty();
        let usual = SCENARIOS.map(str::to_owned);
        for name in if named { scenarios } else { &usual } {
            let scenario = match Scenario::load(name) {
                Err(error @ ScenarioError::MissingFile { .. }) if !named => {
                    plan.missing.push(Missing { scenario: name.clone(), reason: error.to_string() });
                    continue;
                }
                loaded => loaded.or_bad_input()?,
            };
            if plan.subjects.iter().any(|subject| subject.scenario.name == scenario.name) {
                return Err(Failure::input(format!(
                    "two scenarios are called {}; give each once, or rename one in its scenario.toml",
                    scenario.name
                )));
            }
            let layout = load_layout(&scenario, &plan.env).or_bad_input()?;
            for env in policies.iter().filter_map(PolicySpec::env) {
                load_layout(&scenario, env).or_bad_input()?;
            }
            let usual = default_policies();
            let policies = if policies.is_empty() { &usual } else { policies };
            plan.subjects.push(Subject {
                policies: resolved(policies, &scenario),
                seeds,
                vehicles: scenario.vehicles().or_bad_input()?,
                layout_hash: layout.hash(),
                scenario,
            });
        }
        Ok(plan)
    }

    /// Every episode, those that take long first: whatever runs last leaves cores idle.
    pub(crate) fn jobs(&self) -> Vec<Job<'_>> {
        let mut jobs: Vec<_> = self
            .subjects
            .iter()
            .flat_map(|subject| {
                subject.policies.iter().flat_map(move |policy| {
                    subject.seeds(policy).into_iter().map(move |seed| Job { subject, policy, seed })
                })
            })
            .collect();
        // Stable, so that seeds of one rule stay together.
        jobs.sort_by(|a, b| b.weight().total_cmp(&a.weight()));
        jobs
    }

    /// What the result of an episode depends on.
    pub(crate) fn made(&self, job: &Job<'_>) -> Made {
        Made::new(&job.subject.scenario, self.env(job.policy), &self.sumo_version, job.policy, job.seed)
    }

    /// The environment that a policy is evaluated in: its own if it has one.
    pub(crate) fn env<'p>(&'p self, policy: &'p PolicySpec) -> &'p EnvConfig {
        policy.env().unwrap_or(&self.env)
    }
}

impl Subject {
    /// SUMO seeds of a policy.
    pub(crate) fn seeds(&self, policy: &PolicySpec) -> Vec<u32> {
        evaluate::seeds(self.seeds.unwrap_or_else(|| default_seeds(&self.scenario.name, policy)))
    }
}

impl Job<'_> {
    /// About how much work it is, in no unit: SUMO's time goes with the vehicles that are there, and a rule that lets them
    /// wait has more of them.
    pub(crate) fn weight(&self) -> f64 {
        let waiting = match self.policy.rule() {
            None
            | Some(
                RuleBased::MaxPressure
                | RuleBased::MaxPressureStopped
                | RuleBased::MaxPressureAll
                | RuleBased::MaxPressureStopped50m
                | RuleBased::Greedy,
            ) => 1.0,
            Some(_) => 1.5,
        };
        // A grid that jams costs more than its vehicles tell.
        let jams = if self.subject.scenario.name == "grid5x5" { 2.0 } else { 1.0 };
        waiting * jams * (self.subject.vehicles.max(1) as f64)
    }
}

/// Refuses a policy that decides at other times than the others in the table, or for longer.
fn same_clock(policy: &PolicySpec, env: &EnvConfig) -> Outcome<()> {
    let clock = |env: &EnvConfig| (env.decision_seconds, env.yellow_seconds, env.episode_seconds);
    match policy.env() {
        Some(own) if clock(own) != clock(env) => Err(Failure::input(format!(
            "{} was trained for a decision every {} s with {} s of yellow and episodes of {} s, and the table is of {}, {} and {} s; \
             train with these under [env], or measure it by itself with cross eval",
            policy.name(),
            own.decision_seconds,
            own.yellow_seconds,
            own.episode_seconds,
            env.decision_seconds,
            env.yellow_seconds,
            env.episode_seconds,
        ))),
        _ => Ok(()),
    }
}

/// The variant of Max-Pressure with which the paper's row of a scenario is reproduced.
pub(crate) fn published_variant(scenario: &Scenario) -> RuleBased {
    // A variant without a name of its own stays the scenario's `max-pressure`.
    let variant = MaxPressure::from(scenario.reference.max_pressure);
    variant.name().parse().unwrap_or(RuleBased::MaxPressure)
}

/// Policies without aliases, each once; rules first, in their order.
fn resolved(policies: &[PolicySpec], scenario: &Scenario) -> Vec<PolicySpec> {
    let mut distinct: Vec<PolicySpec> = Vec::new();
    for policy in policies {
        let policy = match policy.rule() {
            Some(RuleBased::MaxPressure) => PolicySpec::Rule(published_variant(scenario)),
            _ => policy.clone(),
        };
        if distinct.iter().all(|other| other.key() != policy.key()) {
            distinct.push(policy);
        }
    }
    // In the order of the table, however they were asked for.
    let place = |policy: &PolicySpec| RuleBased::ALL.iter().position(|&rule| Some(rule) == policy.rule());
    distinct.sort_by_key(|policy| place(policy).unwrap_or(usize::MAX));
    distinct
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(scenarios: &[&str], policies: &[RuleBased], seeds: Option<u32>) -> Outcome<Plan> {
        let scenarios: Vec<_> = scenarios.iter().map(|&name| name.to_owned()).collect();
        let policies: Vec<_> = policies.iter().copied().map(PolicySpec::Rule).collect();
        Plan::new(&scenarios, &policies, seeds, EnvConfig::default(), "1.28.0".to_owned())
    }

    fn rules(policies: &[PolicySpec]) -> Vec<RuleBased> {
        policies.iter().filter_map(PolicySpec::rule).collect()
    }

    #[test]
    fn an_alias_is_the_variant_it_stands_for_and_runs_once() {
        let plan = plan(&["grid4x4"], &[RuleBased::MaxPressureAll, RuleBased::MaxPressure], Some(2)).unwrap();
        assert_eq!(rules(&plan.subjects[0].policies), [RuleBased::MaxPressureAll]);
        assert_eq!(plan.jobs().len(), 2);
    }

    #[test]
    fn definitions_and_reports_take_the_same_variant_for_the_paper_s() {
        for name in ["grid4x4", "arterial4x4", "grid5x5"] {
            let scenario = Scenario::load(name).unwrap();
            assert_eq!(
                crate::paper::max_pressure_variant(name),
                Some(published_variant(&scenario)),
                "{name}"
            );
        }
        for name in SCENARIOS {
            assert!(crate::paper::max_pressure_variant(name).is_some(), "{name}");
        }
    }

    #[test]
    fn the_usual_rules_are_all_but_chance() {
        let plan = plan(&["arterial4x4"], &[], None).unwrap();
        let policies = rules(&plan.subjects[0].policies);
        assert!(!policies.contains(&RuleBased::Random) && !policies.contains(&RuleBased::MaxPressure));
        assert_eq!(policies.len(), RuleBased::ALL.len() - 2);
        assert_eq!(plan.subjects[0].seeds(&PolicySpec::Rule(RuleBased::FixedTime)), [1, 2, 3]);
        assert_eq!(published_variant(&plan.subjects[0].scenario), RuleBased::MaxPressureAll);
    }

    #[test]
    fn chaos_takes_more_seeds_where_there_is_something_to_compare_with() {
        let counts = |seeds| {
            let plan = plan(&["grid5x5"], &[RuleBased::MaxPressure, RuleBased::Greedy], seeds).unwrap();
            let subject = &plan.subjects[0];
            let seeds = |rule| subject.seeds(&PolicySpec::Rule(rule)).len();
            (seeds(RuleBased::MaxPressureStopped50m), seeds(RuleBased::Greedy), plan.jobs().len())
        };
        assert_eq!(counts(None), (10, 1, 11));
        assert_eq!(counts(Some(2)), (2, 2, 4));
    }

    #[test]
    fn long_episodes_come_first() {
        let plan =
            plan(&["grid4x4", "arterial4x4"], &[RuleBased::Greedy, RuleBased::FixedTime], Some(1)).unwrap();
        let order: Vec<_> = plan
            .jobs()
            .iter()
            .map(|job| (job.subject.scenario.name.clone(), job.policy.rule().unwrap()))
            .collect();
        assert_eq!(
            order,
            [
                ("arterial4x4".to_owned(), RuleBased::FixedTime),
                ("arterial4x4".to_owned(), RuleBased::Greedy),
                ("grid4x4".to_owned(), RuleBased::FixedTime),
                ("grid4x4".to_owned(), RuleBased::Greedy),
            ]
        );
    }

    #[test]
    fn what_is_named_must_be_there_and_once() {
        for (scenarios, part) in [(&["grid4x5"][..], "grid4x5"), (&["grid4x4", "grid4x4"], "grid4x4")] {
            let failure = plan(scenarios, &[], Some(1)).unwrap_err();
            assert_eq!(failure.code(), crate::failure::BAD_INPUT);
            assert!(failure.to_string().contains(part), "{failure}");
        }
    }
}
