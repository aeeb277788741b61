//! Phases of the crossings.

use super::GridOptions;
use super::roads::{GridLink, Heading, Place, Turn, light_id, links, places};
use super::shape::Shape;
use crate::generate::plain::Program;

/// The program of every crossing.
pub(super) fn programs(options: &GridOptions, shape: &Shape) -> Vec<Program> {
    let program = |place: Place| {
        let states = states(options, shape, place).into_iter();
        let greens: Vec<_> = states.map(|state| (options.green_seconds, state)).collect();
        Program::with_yellows(light_id(options, place), &greens, options.yellow_seconds)
    };
    places(options).map(program).collect()
}

/// The green states, those of the avenues first.
///
/// Where left turns have a lane of their own: both directions' left turns, both directions' other traffic, all of one
/// direction, all of the other. Where they share one, a phase for left turns holds up those behind them: both directions
/// together, left turns yielding, and left turns alone only if that is asked for. Where roads are missing, a state is left out
/// if another one lets everybody go whom it lets go.
fn states(options: &GridOptions, shape: &Shape, place: Place) -> Vec<String> {
    let links = links(options, shape, place);
    let comes = |from: Heading| shape.is_open(place, from.opposite());
    let mut states = Vec::new();
    for (headings, lanes) in [
        ([Heading::South, Heading::North], options.avenues.lanes),
        ([Heading::West, Heading::East], options.streets.lanes),
    ] {
        let mut push = |letter: &dyn Fn(&GridLink) -> char| {
            states.push(links.iter().map(|link| on_red(options, link, letter(link))).collect::<String>());
        };
        let of_axis = |link: &GridLink| headings.contains(&link.heading);
        if lanes == 1 {
            push(&|link| match link.turn {
                _ if !of_axis(link) => 'r',
                Turn::Left if comes(link.heading.opposite()) => 'g',
                Turn::Left | Turn::Right | Turn::Straight => 'G',
            });
            if options.protected_left {
                push(&|link| if of_axis(link) && link.turn == Turn::Left { 'G' } else { 'r' });
            }
            continue;
        }
        // Right turns go with the left turns too, unless they may go on red anyway.
        let with_left = |turn| turn == Turn::Left || (turn == Turn::Right && !options.right_on_red);
        push(&|link| if of_axis(link) && with_left(link.turn) { 'G' } else { 'r' });
        push(&|link| if of_axis(link) && link.turn != Turn::Left { 'G' } else { 'r' });
        for heading in headings {
            push(&|link| if link.heading == heading { 'G' } else { 'r' });
        }
    }
    without_idle(&states)
}

/// The states without those in which nobody has more than in another one; of equal ones the first stays.
fn without_idle(states: &[String]) -> Vec<String> {
    let right_of_way = |letter| match letter {
        'G' => 2,
        'g' => 1,
        _ => 0,
    };
    let within = |small: &str, large: &str| {
        small.chars().zip(large.chars()).all(|(small, large)| right_of_way(small) <= right_of_way(large))
    };
    let idle = |index: usize| {
        states.iter().enumerate().any(|(other, state)| {
            other != index
                && within(&states[index], state)
                && (other < index || !within(state, &states[index]))
        })
    };
    (0..states.len()).filter(|&index| !idle(index)).map(|index| states[index].clone()).collect()
}

fn on_red(options: &GridOptions, link: &GridLink, letter: char) -> char {
    if letter == 'r' && link.turn == Turn::Right && options.right_on_red { 's' } else { letter }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::grid::RoadOptions;

    /// The states of the first crossing.
    fn states(options: &GridOptions) -> Vec<String> {
        super::states(options, &Shape::new(options), Place { column: 1, row: 1 })
    }

    #[test]
    fn one_lane_avenues_and_two_lane_streets_have_the_five_published_phases() {
        let expected = ["GGgrrrGGgrrr", "rrrGrGrrrGrG", "rrrGGrrrrGGr", "rrrGGGrrrrrr", "rrrrrrrrrGGG"];
        assert_eq!(states(&GridOptions::default()), expected);
    }

    #[test]
    fn right_on_red_adds_its_letter() {
        let options = GridOptions { right_on_red: true, ..GridOptions::default() };
        let expected = ["GGgsrrGGgsrr", "srrsrGsrrsrG", "srrGGrsrrGGr", "srrGGGsrrsrr", "srrsrrsrrGGG"];
        assert_eq!(states(&options), expected);
    }

    #[test]
    fn more_lanes_give_each_axis_four_phases() {
        let road = RoadOptions { lanes: 3, speed: 14.0 };
        let options = GridOptions { streets: road.clone(), avenues: road, ..GridOptions::default() };
        let states = states(&options);
        assert_eq!(states.len(), 8);
        assert_eq!(states[0], "GrGrrrGrGrrr");
        assert_eq!(states[3], "rrrrrrGGGrrr");
    }

    /// One crossing without one of its roads: that to the south, with this seed.
    fn three_arms(lanes: u32) -> GridOptions {
        let road = RoadOptions { lanes, speed: 14.0 };
        GridOptions {
            columns: 1,
            rows: 1,
            streets: road.clone(),
            avenues: road,
            closed: 0.25,
            seed: SOUTH_IS_CLOSED,
            ..GridOptions::default()
        }
    }
    const SOUTH_IS_CLOSED: u64 = 0;

    #[test]
    fn three_arms_of_one_lane_have_two_phases_and_nobody_yields_to_a_road_that_is_not_there() {
        assert_eq!(states(&three_arms(1)), ["GGrrrr", "rrGGGg"]);
    }

    #[test]
    fn three_arms_of_two_lanes_have_four_phases() {
        assert_eq!(states(&three_arms(2)), ["GGrrrrr", "rrGrrrG", "rrGGGGr", "rrrrrGG"]);
    }

    #[test]
    fn a_state_is_left_out_whose_greens_another_one_has_too() {
        let states = ["Grr", "GGr", "rrG", "rrg", "GGr"].map(str::to_owned).to_vec();
        assert_eq!(without_idle(&states), ["GGr", "rrG"]);
    }

    #[test]
    fn left_turns_out_of_a_shared_lane_have_a_phase_of_their_own_where_somebody_comes_towards_them() {
        let road = RoadOptions { lanes: 1, speed: 14.0 };
        let options = GridOptions {
            streets: road.clone(),
            avenues: road,
            protected_left: true,
            ..GridOptions::default()
        };
        assert_eq!(states(&options), ["GGgrrrGGgrrr", "rrGrrrrrGrrr", "rrrGGgrrrGGg", "rrrrrGrrrrrG"]);
        assert_eq!(
            states(&GridOptions { protected_left: true, ..three_arms(1) }),
            ["GGrrrr", "rrGGGg", "rrrrrG"]
        );
    }
}
