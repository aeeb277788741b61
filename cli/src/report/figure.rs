//! What all drawings share: the frame with its title, what is read out instead of them, legends.

use super::number::pixel;
use maud::{Markup, html};

/// How many colours there are before dashes tell series apart.
pub(super) const COLOURS: usize = 8;
const DASHES: usize = 4;

/// The style classes of the series at a place: a colour, and further on a dash with it.
pub(super) fn series(place: usize) -> String {
    match place / COLOURS % DASHES {
        0 => format!("s{}", place % COLOURS),
        dash => format!("s{} dash{dash}", place % COLOURS),
    }
}

/// A drawing with what belongs to every drawing.
pub(super) struct Figure<'a> {
    /// Unique in the page.
    pub(super) id: &'a str,
    pub(super) title: &'a str,
    /// Follows the title, quieter: a unit, or how to read it.
    pub(super) note: &'a str,
    /// What a person who cannot see it is told.
    pub(super) description: &'a str,
    /// Width and height of the drawing's own coordinates.
    pub(super) size: (f64, f64),
    /// Further classes: `wide` lets it scroll on a small screen instead of shrinking.
    pub(super) class: &'a str,
    /// Between title and drawing; empty where it needs none.
    pub(super) legend: Markup,
}

impl Figure<'_> {
    pub(super) fn draw(&self, content: &Markup) -> Markup {
        let (width, height) = self.size;
        let (title, description) = (format!("{}-title", self.id), format!("{}-description", self.id));
        html! {
            figure id=(self.id) class=(self.class) {
                figcaption { strong { (self.title) } @if !self.note.is_empty() { " " span .note { (self.note) } } }
                (self.legend)
                div .canvas {
                    svg viewBox=(format!("0 0 {} {}", pixel(width), pixel(height))) width=(pixel(width)) height=(pixel(height))
                        role="img" aria-labelledby=(format!("{title} {description}")) {
                        title id=(title) { (self.title) }
                        desc id=(description) { (self.description) }
                        (content)
                    }
                }
            }
        }
    }
}

/// One entry of a legend.
pub(super) struct Key<'a> {
    pub(super) label: &'a str,
    /// Place among the series: see [`series`].
    pub(super) place: usize,
}

/// Names and colours of the series of the figures that follow.
pub(super) fn legend<'a>(keys: impl IntoIterator<Item = Key<'a>>) -> Markup {
    html! {
        ul .legend {
            @for key in keys {
                li .(series(key.place)) {
                    svg width="26" height="10" viewBox="0 0 26 10" aria-hidden="true" { line .line x1="1" y1="5" x2="25" y2="5" {} }
                    (key.label)
                }
            }
        }
    }
}

/// A label that fits into a drawing: its end is what tells paths apart.
pub(super) fn brief(label: &str, characters: usize) -> String {
    let length = label.chars().count();
    if length <= characters {
        return label.to_owned();
    }
    std::iter::once('…').chain(label.chars().skip(length + 1 - characters.max(1))).collect()
}

/// The places of a line, as `points` of a polyline.
pub(super) fn points(places: impl IntoIterator<Item = (f64, f64)>) -> String {
    let places = places.into_iter().map(|(x, y)| format!("{},{}", pixel(x), pixel(y)));
    places.collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_series_stay_apart() {
        let classes: std::collections::HashSet<_> = (0..COLOURS * DASHES).map(series).collect();
        assert_eq!(classes.len(), COLOURS * DASHES);
        assert_eq!(series(0), "s0");
        assert_eq!(series(9), "s1 dash1");
    }

    #[test]
    fn names_are_escaped_wherever_they_stand() {
        let name = "<script>alert(\"1\")</script>";
        let figure = Figure {
            id: "a",
            title: name,
            note: name,
            description: name,
            size: (10.0, 5.0),
            class: "",
            legend: legend([Key { label: name, place: 0 }]),
        };
        let text = figure.draw(&html! { text { (name) } }).into_string();
        assert!(!text.contains("<script>"), "{text}");
        assert_eq!(text.matches("&lt;script&gt;").count(), 6, "{text}");
    }

    #[test]
    fn long_names_lose_their_beginning() {
        assert_eq!(brief("greedy", 8), "greedy");
        assert_eq!(brief("runs/20260131-235959", 8), "…-235959");
    }
}
