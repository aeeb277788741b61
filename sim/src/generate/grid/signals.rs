//! Phases of the crossings.

use super::GridOptions;
use super::roads::{GridLink, Heading, Turn, light_id, links, places};
use crate::generate::plain::Program;

/// The same program at every crossing.
pub(super) fn programs(options: &GridOptions) -> Vec<Program> {
    let greens: Vec<_> = states(options).into_iter().map(|state| (options.green_seconds, state)).collect();
    places(options)
        .map(|place| Program::with_yellows(light_id(options, place), &greens, options.yellow_seconds))
        .collect()
}

/// The green states, those of the avenues first.
///
/// Where left turns have a lane of their own: both directions' left turns, both directions' other traffic, all of one
/// direction, all of the other. Where they share one, a phase for left turns would only hold up those behind them: both
/// directions together, left turns yielding.
fn states(options: &GridOptions) -> Vec<String> {
    let links = links(options);
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
                Turn::Left => 'g',
                Turn::Right | Turn::Straight => 'G',
            });
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
    states
}

fn on_red(options: &GridOptions, link: &GridLink, letter: char) -> char {
    if letter == 'r' && link.turn == Turn::Right && options.right_on_red { 's' } else { letter }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::grid::RoadOptions;

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
}
