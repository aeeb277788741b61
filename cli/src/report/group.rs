//! The evaluations of one scenario: who is who, in which order, in which colour, and whether they may be compared.

use super::figure::COLOURS;
use super::input::Evaluation;
use super::protocol;
use crate::paper::{self, PaperResult};
use cross_sim::controller::RuleBased;
use cross_sim::evaluate::{EvalReport, strongest};
use cross_sim::metrics::Metric;
use serde_json::{Map, Value};
use std::collections::{BTreeMap, BTreeSet};

/// Published policies and what they are called here; a learned policy stands beside the published learned one.
const PUBLISHED_LEARNED: &str = "cross";

/// The evaluations of a scenario.
pub(super) struct Group<'e> {
    pub(super) scenario: &'e str,
    /// Learned policies first, then rules in the order of [`RuleBased::ALL`].
    pub(super) entries: Vec<Entry<'e>>,
    /// The different protocols, in the order of their first entry.
    pub(super) protocols: Vec<Map<String, Value>>,
}

/// A policy in a [`Group`].
pub(super) struct Entry<'e> {
    pub(super) report: &'e EvalReport,
    /// Its name, unlike all others of the group.
    pub(super) label: String,
    /// Place among the colours of the page.
    pub(super) place: usize,
    /// Place among [`Group::protocols`].
    pub(super) protocol: usize,
    pub(super) learned: bool,
    /// The Max-Pressure variant with the lowest trip delay, where several were evaluated.
    pub(super) strongest: bool,
}

impl Entry<'_> {
    /// What the paper calls this policy, were it in it.
    pub(super) fn published_method(&self) -> &str {
        let policy = self.report.policy.as_str();
        let variant = paper::max_pressure_variant(&self.report.scenario);
        match variant {
            _ if self.learned => PUBLISHED_LEARNED,
            // By the full name of the variant, as `cross baselines` and `cross train` evaluate it.
            Some(variant) if variant.name() == policy => RuleBased::MaxPressure.name(),
            _ => policy,
        }
    }

    /// The published figure that this one may be held against: of the same policy, under the same rules.
    pub(super) fn published(&self, metric: Metric) -> Option<&'static PaperResult> {
        let fits = protocol::as_published(self.report);
        fits.then(|| paper::lookup(&self.report.scenario, self.published_method(), metric.key())).flatten()
    }
}

/// Groups by scenario, in the order of names; a policy has one colour on the whole page.
pub(super) fn groups(evaluations: &[Evaluation]) -> Vec<Group<'_>> {
    let mut by_scenario: BTreeMap<&str, Vec<&Evaluation>> = BTreeMap::new();
    for evaluation in evaluations {
        by_scenario.entry(&evaluation.report.scenario).or_default().push(evaluation);
    }
    let mut groups: Vec<Group<'_>> =
        by_scenario.into_iter().map(|(scenario, evaluations)| group(scenario, evaluations)).collect();
    colour(&mut groups);
    groups
}

fn group<'e>(scenario: &'e str, mut evaluations: Vec<&'e Evaluation>) -> Group<'e> {
    evaluations.sort_by_key(|evaluation| rank(&evaluation.report.policy));
    let mut protocols: Vec<Map<String, Value>> = Vec::new();
    let mut entries: Vec<Entry<'e>> = Vec::new();
    let labels = labels(&evaluations);
    for (evaluation, label) in evaluations.iter().zip(labels) {
        let report = &evaluation.report;
        let own = protocol::members(report);
        let protocol = protocols.iter().position(|known| *known == own).unwrap_or_else(|| {
            protocols.push(own);
            protocols.len() - 1
        });
        entries.push(Entry {
            report,
            label,
            place: 0,
            protocol,
            learned: is_learned(&report.policy),
            strongest: false,
        });
    }
    mark_strongest(&mut entries);
    Group { scenario, entries, protocols }
}

/// Learned policies before rules, rules in their own order, strangers by name.
fn rank(policy: &str) -> (usize, String) {
    let rule = policy.parse::<RuleBased>().ok();
    let place = rule.and_then(|rule| RuleBased::ALL.iter().position(|known| *known == rule));
    (place.map_or(0, |place| place + 1), policy.to_owned())
}

fn is_learned(policy: &str) -> bool {
    policy.parse::<RuleBased>().is_err()
}

/// The policies' names, with their origin where two are called the same, and a number where even that does not tell.
fn labels(evaluations: &[&Evaluation]) -> Vec<String> {
    let same = |one: &Evaluation, other: &Evaluation| one.report.policy == other.report.policy;
    let mut labels: Vec<String> = Vec::new();
    for evaluation in evaluations {
        let policy = &evaluation.report.policy;
        let alone = evaluations.iter().filter(|other| same(evaluation, other)).count() == 1;
        let label = if alone { policy.clone() } else { format!("{policy} ({})", evaluation.origin) };
        let taken = labels
            .iter()
            .filter(|other| **other == label || other.starts_with(&format!("{label} #")))
            .count();
        labels.push(if taken == 0 { label } else { format!("{label} #{}", taken + 1) });
    }
    labels
}

/// Marks the Max-Pressure variant to beat, where there is a choice within one protocol and the same seeds.
fn mark_strongest(entries: &mut [Entry<'_>]) {
    let variants: Vec<usize> = (0..entries.len())
        .filter(|&place| {
            let policy = &entries[place].report.policy;
            RuleBased::MAX_PRESSURE_VARIANTS.iter().any(|variant| variant.name() == policy)
        })
        .collect();
    let Some(&first) = variants.first() else { return };
    let alike = variants.iter().all(|&place| {
        (entries[place].protocol, &entries[place].report.seeds)
            == (entries[first].protocol, &entries[first].report.seeds)
    });
    if variants.len() < 2 || !alike {
        return;
    }
    let best = strongest(variants.iter().map(|&place| entries[place].report));
    if let Some(place) =
        variants.iter().find(|&&place| best.is_some_and(|best| std::ptr::eq(best, entries[place].report)))
    {
        entries[*place].strongest = true;
    }
}

/// Gives each label of the page a colour: the same one in every scenario, and none that another label of a scenario has.
///
/// Each label in turn takes the colour that is rarest on the page among those that no neighbour has, so that colours come
/// again only where there are more labels than colours.
fn colour(groups: &mut [Group<'_>]) {
    let mut labels: Vec<(bool, (usize, String), String)> = groups
        .iter()
        .flat_map(|group| &group.entries)
        .map(|entry| (!entry.learned, rank(&entry.report.policy), entry.label.clone()))
        .collect();
    labels.sort();
    labels.dedup();
    let mut places: BTreeMap<String, usize> = BTreeMap::new();
    for (_, _, label) in labels {
        let with_it = groups.iter().filter(|group| group.entries.iter().any(|entry| entry.label == label));
        let neighbours = with_it.flat_map(|group| &group.entries);
        let taken: BTreeSet<usize> =
            neighbours.filter_map(|entry| places.get(&entry.label).copied()).collect();
        let uses = |place: usize| places.values().filter(|used| **used == place).count();
        let free = (0..COLOURS).filter(|place| !taken.contains(place));
        // With all colours taken, the dashed ones follow: of one more than are taken, one is free.
        let place = free
            .min_by_key(|&place| uses(place))
            .or_else(|| (0..=taken.len()).find(|place| !taken.contains(place)));
        let place = place.unwrap_or(taken.len());
        places.insert(label, place);
    }
    for entry in groups.iter_mut().flat_map(|group| &mut group.entries) {
        entry.place = places.get(&entry.label).copied().unwrap_or(0);
    }
}

impl Group<'_> {
    /// Whether the figures of this scenario were made under the same rules, on the same seeds.
    pub(super) fn comparable(&self) -> bool {
        let mut seeds = self.entries.iter().map(|entry| &entry.report.seeds);
        let first = seeds.next();
        protocol::comparable(&self.protocols) && seeds.all(|other| Some(other) == first)
    }

    /// The learned policies against the rule to beat, in words; nothing where that would be no fair comparison.
    pub(super) fn verdicts(&self) -> Vec<String> {
        if !self.comparable() {
            return Vec::new();
        }
        let delay = |entry: &Entry<'_>| entry.report.get(Metric::TripDelay).mean;
        let spread = |entry: &Entry<'_>| entry.report.get(Metric::TripDelay).std_between_seeds;
        let rules = self.entries.iter().filter(|entry| !entry.learned);
        let Some(best) = rules.min_by(|a, b| delay(a).total_cmp(&delay(b))) else { return Vec::new() };
        let verdict = |entry: &Entry<'_>| {
            let (own, other) = (delay(entry), delay(best));
            let change = 100.0 * (own - other) / other;
            let direction = if change < 0.0 { "below" } else { "above" };
            let chance = (own - other).abs() <= spread(entry).max(spread(best));
            let chance = if chance { ", within the spread of the seeds" } else { "" };
            change.is_finite().then(|| {
                format!(
                    "{}: mean trip delay {own:.1} s, {:.0} % {direction} the best rule here ({}, {other:.1} s){chance}",
                    entry.label,
                    change.abs(),
                    best.label
                )
            })
        };
        self.entries.iter().filter(|entry| entry.learned).filter_map(verdict).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::samples;
    use super::*;

    fn evaluations(reports: Vec<EvalReport>) -> Vec<Evaluation> {
        reports.into_iter().map(|report| Evaluation::sample(report, "here")).collect()
    }

    #[test]
    fn learned_policies_come_first_and_a_policy_has_one_colour() {
        let all = evaluations(vec![
            samples::report("b", "greedy", &[1]),
            samples::report("b", "fixed-time", &[1]),
            samples::report("a", "greedy", &[1]),
            samples::report("b", "cross", &[1]),
        ]);
        let groups = groups(&all);
        let labels: Vec<_> = groups[1].entries.iter().map(|entry| entry.label.as_str()).collect();
        assert_eq!((groups[0].scenario, groups[1].scenario), ("a", "b"));
        assert_eq!(labels, ["cross", "fixed-time", "greedy"]);
        assert_eq!(groups[0].entries[0].place, groups[1].entries[2].place);
        assert_eq!(groups[1].entries[0].place, 0);
    }

    #[test]
    fn no_two_policies_of_a_scenario_share_a_colour() {
        let policies = |scenario: &'static str, names: std::ops::Range<u32>| {
            names.map(move |name| samples::report(scenario, &format!("p{name:02}"), &[1]))
        };
        let all = evaluations(policies("a", 0..6).chain(policies("b", 4..12)).collect());
        let groups = groups(&all);
        for group in &groups {
            let places: BTreeSet<usize> = group.entries.iter().map(|entry| entry.place).collect();
            assert_eq!(places.len(), group.entries.len(), "{places:?}");
            assert!(places.iter().all(|&place| place < COLOURS), "there are colours enough: {places:?}");
        }
        // With no more labels than colours each has one of its own.
        let few = evaluations(policies("a", 0..4).chain(policies("b", 4..8)).collect());
        let groups = super::groups(&few);
        let places: BTreeSet<_> =
            groups.iter().flat_map(|group| &group.entries).map(|entry| entry.place).collect();
        assert_eq!(places.len(), 8);
    }

    #[test]
    fn equal_names_are_told_apart() {
        let mut all =
            evaluations(vec![samples::report("a", "cross", &[1]), samples::report("a", "cross", &[2])]);
        all.push(Evaluation::sample(samples::report("a", "cross", &[3]), "there"));
        let groups = groups(&all);
        let labels: Vec<_> = groups[0].entries.iter().map(|entry| entry.label.as_str()).collect();
        assert_eq!(labels, ["cross (here)", "cross (here) #2", "cross (there)"]);
    }

    #[test]
    fn the_strongest_variant_and_the_verdict_follow_the_trip_delay() {
        let all = evaluations(vec![
            samples::report("a", "max-pressure-all", &[4]),
            samples::report("a", "cross", &[4]),
            samples::report("a", "max-pressure-stopped", &[4]),
        ]);
        let groups = groups(&all);
        assert_eq!(groups[0].entries.iter().filter(|entry| entry.strongest).count(), 1);
        assert_eq!(
            groups[0].verdicts(),
            [
                "cross: mean trip delay 4.0 s, 0 % above the best rule here (max-pressure-stopped, 4.0 s), within the spread of the seeds"
            ]
        );
        // Without the same seeds there is no choice to make and nothing to say.
        let other = evaluations(vec![
            samples::report("a", "max-pressure-all", &[1]),
            samples::report("a", "cross", &[3]),
            samples::report("a", "max-pressure-stopped", &[2]),
        ]);
        let other = super::groups(&other);
        assert!(other[0].entries.iter().all(|entry| !entry.strongest) && other[0].verdicts().is_empty());
    }
}
