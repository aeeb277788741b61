//! Under what rules results were made, and whether they may stand beside each other.

use super::group::Group;
use super::number;
use crate::paper;
use cross_sim::evaluate::EvalReport;
use maud::{Markup, html};
use serde_json::{Map, Value};

/// Members of a protocol that only learned policies see: rules give the same figures whatever they are.
const SEEN_BY_LEARNED_ALONE: [&str; 3] = ["detection", "reward_range_metres", "reward_beyond"];
/// Digits of a hash that are shown; the whole one is in the table of protocols.
const HASH_DIGITS: usize = 10;

/// The protocol of an evaluation as its JSON has it, so that nothing of a newer one is passed over.
pub(super) fn members(report: &EvalReport) -> Map<String, Value> {
    match serde_json::to_value(&report.protocol) {
        Ok(Value::Object(members)) => members,
        // A struct of plain members is an object.
        _ => Map::new(),
    }
}

/// A name for a protocol among several: A, B, C, ...
pub(super) fn letter(place: usize) -> String {
    match u8::try_from(place) {
        Ok(place) if place < 26 => char::from(b'A' + place).to_string(),
        _ => format!("#{}", place + 1),
    }
}

/// What a reader must be told before comparing the results of a scenario.
pub(super) struct Caution {
    /// Whether comparing is wrong rather than to be done with care.
    pub(super) grave: bool,
    pub(super) text: String,
}

/// Seconds between decisions, of yellow, and of an episode that fit the published figures: see `docs/baselines.md`.
const PUBLISHED: (u32, u32, u32) = (10, 3, 3600);

/// Whether an evaluation was made under the rules that the published figures fit.
pub(super) fn as_published(report: &EvalReport) -> bool {
    let own = &report.protocol;
    (own.interval_seconds, own.yellow_seconds, own.episode_seconds) == PUBLISHED
}

/// Everything that stands against a comparison.
pub(super) fn cautions(group: &Group<'_>) -> Vec<Caution> {
    let mut cautions = Vec::new();
    let differing = differing(&group.protocols);
    let (seen, grave): (Vec<&String>, Vec<&String>) =
        differing.iter().partition(|member| SEEN_BY_LEARNED_ALONE.contains(&member.as_str()));
    if !grave.is_empty() {
        let text = format!(
            "Results of different protocols stand in one table; compare only rows that bear the same letter. They differ in {}.",
            listed(&grave)
        );
        cautions.push(Caution { grave: true, text });
    } else if !seen.is_empty() {
        let text = format!("The protocols differ in {}, which only learned policies see.", listed(&seen));
        cautions.push(Caution { grave: false, text });
    }
    let in_paper = paper::results().iter().any(|result| result.scenario == group.scenario);
    if in_paper && group.entries.iter().any(|entry| !as_published(entry.report)) {
        let (interval, yellow, episode) = PUBLISHED;
        let text = format!(
            "The published figures are of a decision every {interval} s with {yellow} s of yellow over {episode} s; those here that were made otherwise do not compare with them."
        );
        cautions.push(Caution { grave: true, text });
    }
    let seeds = group.entries.iter().map(|entry| &entry.report.seeds);
    if seeds.clone().any(|other| Some(other) != seeds.clone().next()) {
        let text = "The policies were not evaluated on the same SUMO seeds; a part of their difference may be chance.";
        cautions.push(Caution { grave: true, text: text.to_owned() });
    }
    for entry in group.entries.iter().filter(|entry| !entry.report.gridlocked_seeds.is_empty()) {
        let text = format!(
            "Gridlock under {} ({}): traffic stood still before the end. Such figures describe a network that stands; small differences between them mean nothing.",
            entry.label,
            seeds_in_words(&entry.report.gridlocked_seeds)
        );
        cautions.push(Caution { grave: true, text });
    }
    if group.entries.iter().all(|entry| entry.report.seeds.len() == 1) {
        let text = "One seed each: nothing here tells how much is chance.".to_owned();
        cautions.push(Caution { grave: false, text });
    }
    cautions
}

/// Whether results of these protocols may be compared: they differ at most in what only learned policies see.
pub(super) fn comparable(protocols: &[Map<String, Value>]) -> bool {
    differing(protocols).iter().all(|member| SEEN_BY_LEARNED_ALONE.contains(&member.as_str()))
}

/// The members in which protocols differ.
fn differing(protocols: &[Map<String, Value>]) -> Vec<String> {
    let Some(first) = protocols.first() else { return Vec::new() };
    let mut members: Vec<&String> = protocols.iter().flat_map(Map::keys).collect();
    members.sort();
    members.dedup();
    let differs =
        |member: &&&String| protocols.iter().any(|other| other.get(**member) != first.get(**member));
    members.iter().filter(differs).map(|member| (*member).clone()).collect()
}

fn listed(members: &[&String]) -> String {
    members.iter().map(|member| name(member)).collect::<Vec<_>>().join(", ")
}

/// `interval_seconds` as `interval, s`.
fn name(member: &str) -> String {
    let units = [("_seconds", ", s"), ("_metres", ", m")];
    let with_unit = units.iter().find_map(|(end, unit)| Some(format!("{}{unit}", member.strip_suffix(end)?)));
    with_unit.unwrap_or_else(|| member.to_owned()).replace('_', " ").replace("sumo", "SUMO")
}

/// A protocol on a line.
pub(super) fn line(report: &EvalReport) -> Markup {
    let own = &report.protocol;
    let teleport = match own.time_to_teleport_seconds {
        never if never < 0.0 => "no teleports".to_owned(),
        seconds => format!("teleport after {seconds} s"),
    };
    let signals = if report.signals_by_sumo() {
        vec![format!("signals by SUMO, read every {} s", own.interval_seconds)]
    } else {
        vec![format!("decision every {} s", own.interval_seconds), format!("{} s yellow", own.yellow_seconds)]
    };
    let mut parts = signals;
    parts.extend([
        format!("{} s", number::count(own.episode_seconds.into())),
        teleport,
        format!("detection {}", shown(members(report).get("detection"))),
        seeds_in_words(&report.seeds),
        format!("SUMO {}", own.sumo_version),
    ]);
    if let Some(Value::String(preset)) = members(report).get("preset") {
        parts.insert(0, format!("protocol {preset}"));
    }
    html! {
        @for part in parts { span .chip { (part) } }
        span .chip { "net " code title=(own.net_hash) { (hash(&own.net_hash)) } }
        span .chip { "demand " code title=(own.demand_hash) { (hash(&own.demand_hash)) } }
    }
}

fn hash(text: &str) -> String {
    text.chars().take(HASH_DIGITS).collect()
}

/// Seeds as people name them.
pub(super) fn seeds_in_words(seeds: &[u32]) -> String {
    match seeds {
        [] => "no seeds".to_owned(),
        [one] => format!("seed {one}"),
        [first, .., last] if seeds.windows(2).all(|pair| pair[0].checked_add(1) == Some(pair[1])) => {
            format!("seeds {first} to {last}")
        }
        _ => format!("seeds {}", seeds.iter().map(u32::to_string).collect::<Vec<_>>().join(", ")),
    }
}

/// Every member of every protocol of a scenario, one column each.
pub(super) fn table(group: &Group<'_>) -> Markup {
    let mut names: Vec<&String> = Vec::new();
    for member in group.protocols.iter().flat_map(Map::keys) {
        if !names.contains(&member) {
            names.push(member);
        }
    }
    let differing = differing(&group.protocols);
    html! {
        div .scroll {
            table .protocol {
                caption { "Protocol of " (group.scenario) ": what the figures depend on besides policy and seeds" }
                thead {
                    tr {
                        th scope="col" { "setting" }
                        @for place in 0..group.protocols.len() {
                            th scope="col" {
                                @if group.protocols.len() > 1 { (letter(place)) ": " (users(group, place)) } @else { "all policies" }
                            }
                        }
                    }
                }
                tbody {
                    @for member in names {
                        tr .differs[differing.contains(member)] {
                            th scope="row" { (name(member)) }
                            @for protocol in &group.protocols { td { (shown(protocol.get(member))) } }
                        }
                    }
                }
            }
        }
    }
}

fn users(group: &Group<'_>, place: usize) -> String {
    let users = group.entries.iter().filter(|entry| entry.protocol == place);
    users.map(|entry| entry.label.as_str()).collect::<Vec<_>>().join(", ")
}

fn shown(value: Option<&Value>) -> String {
    match value {
        None | Some(Value::Null) => number::NONE.to_owned(),
        Some(Value::String(text)) => text.clone(),
        Some(other) => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::super::{group, input::Evaluation, samples};
    use super::*;
    use serde_json::json;

    fn cautions_of(reports: Vec<EvalReport>) -> Vec<(bool, String)> {
        let all: Vec<_> = reports.into_iter().map(|report| Evaluation::sample(report, "x")).collect();
        let groups = group::groups(&all);
        cautions(&groups[0]).into_iter().map(|caution| (caution.grave, caution.text)).collect()
    }

    #[test]
    fn different_protocols_seeds_and_gridlock_are_said_loudly() {
        let yellow = samples::with_protocol("s", "b", "yellow_seconds", json!(5));
        let mut locked = samples::report("s", "c", &[1, 2]);
        locked.gridlocked_seeds = vec![2];
        let told = cautions_of(vec![samples::report("s", "a", &[1]), yellow, locked]);
        assert_eq!(told.len(), 3, "{told:?}");
        assert!(told.iter().all(|(grave, _)| *grave));
        assert!(told[0].1.contains("yellow, s") && told[1].1.contains("same SUMO seeds"), "{told:?}");
        assert!(told[2].1.contains("Gridlock under c (seed 2)"), "{told:?}");
    }

    #[test]
    fn published_figures_are_held_against_their_own_protocol_alone() {
        let short = samples::with_protocol("grid4x4", "fixed-time", "episode_seconds", json!(900));
        let told = cautions_of(vec![short]);
        assert!(told[0].0 && told[0].1.contains("over 3600 s"), "{told:?}");
        let elsewhere = samples::with_protocol("elsewhere", "fixed-time", "episode_seconds", json!(900));
        assert!(cautions_of(vec![elsewhere]).iter().all(|(grave, _)| !grave));
    }

    #[test]
    fn what_only_learned_policies_see_is_said_quietly() {
        let paper = samples::with_protocol("s", "b", "detection", json!("paper"));
        let told = cautions_of(vec![samples::report("s", "a", &[1]), paper]);
        assert!(!told[0].0 && told[0].1.contains("detection"), "{told:?}");
        assert!(
            cautions_of(vec![samples::report("s", "a", &[1, 2]), samples::report("s", "b", &[1, 2])])
                .is_empty()
        );
    }

    #[test]
    fn the_table_shows_every_member_and_marks_what_differs() {
        let all = [
            Evaluation::sample(samples::report("s", "a", &[1]), "x"),
            Evaluation::sample(samples::with_protocol("s", "b", "net_hash", json!("dddd")), "x"),
        ];
        let groups = group::groups(&all);
        let text = table(&groups[0]).into_string();
        assert_eq!(text.matches("<tr class=\"differs\">").count(), 1, "{text}");
        for part in ["interval, s", "A: a", "B: b", "aaaaaaaaaaaaaaaa", "dddd", "SUMO version"] {
            assert!(text.contains(part), "{part} is missing in {text}");
        }
    }

    #[test]
    fn seeds_and_letters_are_brief() {
        assert_eq!(seeds_in_words(&[1, 2, 3]), "seeds 1 to 3");
        assert_eq!(seeds_in_words(&[1, 3]), "seeds 1, 3");
        assert_eq!(seeds_in_words(&[7]), "seed 7");
        assert_eq!([0, 25, 26].map(letter), ["A", "Z", "#27"]);
    }
}
