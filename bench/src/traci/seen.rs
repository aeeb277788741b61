//! What a client saw at each decision, and whether two of them saw the same.

use crate::error::BenchError;
use cross_sim::lanes::{LaneCounts, LaneTable};
use cross_sim::layout::NetworkLayout;
use std::path::Path;

/// Counts `[decisions][lane rows]` of the layout's lanes.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) struct Seen {
    decisions: Vec<Vec<LaneCounts>>,
    /// Vehicles looked at, over all decisions, where the client tells of each.
    pub(super) vehicles: Option<usize>,
}

impl Seen {
    /// Adds what a table holds at a decision.
    pub(super) fn note(&mut self, lanes: &LaneTable) {
        self.decisions.push(lanes.rows().copied().collect());
    }

    /// Reads what a client program wrote: at each decision a line with the number of vehicles, then one for each of them
    /// with its position on the lane in metres, its speed in m/s and the lane's id, which is empty off the road. `lanes`
    /// counts them.
    pub(super) fn read(path: &Path, lanes: &mut LaneTable) -> Result<Self, BenchError> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| BenchError::Read { path: path.to_owned(), source })?;
        Self::parse(&text, lanes).map_err(|line| BenchError::Seen { path: path.to_owned(), line })
    }

    /// The error is the number of the line that cannot be read.
    fn parse(text: &str, lanes: &mut LaneTable) -> Result<Self, usize> {
        let mut seen = Self::default();
        let mut all = 0;
        let mut lines = (1_usize..).zip(text.lines());
        while let Some((number, line)) = lines.next() {
            let vehicles: usize = line.parse().map_err(|_| number)?;
            lanes.clear();
            for _ in 0..vehicles {
                let (number, line) = lines.next().ok_or(number)?;
                let (position, speed, lane) = vehicle(line).ok_or(number)?;
                lanes.add(lane, position, speed);
            }
            all += vehicles;
            seen.note(lanes);
        }
        seen.vehicles = Some(all);
        Ok(seen)
    }

    /// Nothing if both saw the same traffic, else where they first differ.
    pub(super) fn check(
        &self,
        theirs: &Self,
        client: &str,
        layout: &NetworkLayout,
    ) -> Result<(), BenchError> {
        let other = |decision: usize, lane: &str, ours: String, theirs: String| {
            let (client, lane) = (client.to_owned(), lane.to_owned());
            Err(BenchError::OtherObservations { client, decision, lane, ours, theirs })
        };
        if self.decisions.len() != theirs.decisions.len() {
            let count = |seen: &Self| format!("{} decisions", seen.decisions.len());
            let decision = self.decisions.len().min(theirs.decisions.len()) + 1;
            return other(decision, "every lane", count(self), count(theirs));
        }
        for (decision, (ours, theirs)) in (1..).zip(self.decisions.iter().zip(&theirs.decisions)) {
            if let Some(row) = (0..ours.len().max(theirs.len())).find(|&row| ours.get(row) != theirs.get(row))
            {
                let counts = |rows: &[LaneCounts]| {
                    rows.get(row).map_or_else(|| "nothing".to_owned(), |counts| format!("{counts:?}"))
                };
                return other(decision, &lane(layout, row), counts(ours), counts(theirs));
            }
        }
        Ok(())
    }
}

fn vehicle(line: &str) -> Option<(f64, f64, &str)> {
    let mut fields = line.splitn(3, ' ');
    let mut number = || fields.next()?.parse().ok();
    let (position, speed) = (number()?, number()?);
    Some((position, speed, fields.next()?))
}

/// The lane of a row.
fn lane(layout: &NetworkLayout, row: usize) -> String {
    let mut lanes = layout.intersections.iter().flat_map(|own| own.incoming.iter().chain(&own.outgoing));
    lanes.nth(row).map_or_else(String::new, |lane| format!("lane {}", lane.id))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::update::data::{Shape, network};

    fn parse(layout: &NetworkLayout, text: &str) -> Result<Seen, usize> {
        Seen::parse(text, &mut LaneTable::new(layout, 50.0))
    }

    #[test]
    fn vehicles_are_counted_on_their_lanes() {
        let layout = network(&[Shape { agents: 1, phases: 2, movements: 4, lanes: 2 }]);
        let [first, second] = [0, 1].map(|lane| layout.intersections[0].incoming[lane].id.clone());
        let length = layout.intersections[0].incoming[0].length;
        let text = format!("2\n{length} 0.05 {first}\n1e0 5 {second}\n0\n1\n-1073741824.0 0 \n");
        let seen = parse(&layout, &text).unwrap();
        assert_eq!((seen.decisions.len(), seen.vehicles), (3, Some(3)));
        assert_eq!((seen.decisions[0][0].stopped_near, seen.decisions[0][1].total), (1, 1));
        assert_eq!(seen.decisions[1], seen.decisions[2], "a vehicle off the road is on no lane");
    }

    #[test]
    fn a_file_that_is_cut_off_or_no_such_file_is_refused_with_its_line() {
        let layout = network(&[Shape { agents: 1, phases: 2, movements: 4, lanes: 2 }]);
        for (text, line) in [("2\n1 2 a\n", 1), ("0\nx\n", 2), ("1\n1 two a\n", 2), ("1\n1 2\n", 2)] {
            assert_eq!(parse(&layout, text), Err(line), "{text:?}");
        }
    }

    #[test]
    fn one_vehicle_elsewhere_at_one_decision_is_other_traffic() {
        let layout = network(&[Shape { agents: 1, phases: 2, movements: 4, lanes: 2 }]);
        let [first, second] = [0, 1].map(|lane| layout.intersections[0].incoming[lane].id.clone());
        let seen = |lane: &str| parse(&layout, &format!("0\n1\n3.5 2 {lane}\n")).unwrap();
        assert!(seen(&first).check(&seen(&first), "x", &layout).is_ok());
        let error = seen(&first).check(&seen(&second), "x", &layout).unwrap_err();
        let text = error.to_string();
        assert!(text.contains("decision 2") && text.contains(&format!("lane {first}")), "{text}");
        let short = parse(&layout, "0\n").unwrap();
        assert!(seen(&first).check(&short, "x", &layout).is_err());
    }
}
