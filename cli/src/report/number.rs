//! Numbers as a page shows them.

/// What stands for a number that there is not.
pub(super) const NONE: &str = "–";

/// With so many digits after the point, thousands apart, a true minus.
pub(super) fn fixed(value: f64, digits: usize) -> String {
    if !value.is_finite() {
        return NONE.to_owned();
    }
    let text = format!("{:.digits$}", value.abs());
    let (whole, fraction) = text.split_once('.').map_or((text.as_str(), None), |(w, f)| (w, Some(f)));
    let mut shown = String::with_capacity(text.len() + 8);
    // What rounds to zero has no sign.
    if value < 0.0 && text.bytes().any(|digit| (b'1'..=b'9').contains(&digit)) {
        shown.push('−');
    }
    shown.push_str(&grouped(whole));
    if let Some(fraction) = fraction {
        shown.push('.');
        shown.push_str(fraction);
    }
    shown
}

/// A whole number, thousands apart.
pub(super) fn count(value: u64) -> String {
    grouped(&value.to_string())
}

/// Of one noun: `1 seed`, `2 seeds`.
pub(super) fn counted(value: usize, noun: &str) -> String {
    let plural = if value == 1 { "" } else { "s" };
    format!("{} {noun}{plural}", count(value as u64))
}

/// With about three digits that matter: what a tooltip needs.
pub(super) fn short(value: f64) -> String {
    let size = value.abs();
    let digits = match size {
        _ if size == 0.0 || size >= 100.0 => 0,
        _ if size >= 10.0 => 1,
        _ if size >= 1.0 => 2,
        _ if size >= 1e-3 => 3,
        _ if size.is_finite() => return format!("{value:.1e}").replace('-', "−"),
        _ => 0,
    };
    fixed(value, digits)
}

/// With about two digits that matter: what a legend has room for.
pub(super) fn brief(value: f64) -> String {
    let size = value.abs();
    let digits = match size {
        _ if size == 0.0 || size >= 10.0 => 0,
        _ if size >= 1.0 => 1,
        _ if size >= 0.1 => 2,
        _ => 3,
    };
    fixed(value, digits)
}

/// A length of time for people.
pub(super) fn duration(seconds: f64) -> String {
    if !seconds.is_finite() || seconds < 0.0 {
        return NONE.to_owned();
    }
    let seconds = seconds.round() as u64;
    match (seconds / 3600, seconds / 60 % 60, seconds % 60) {
        (0, 0, s) => format!("{s} s"),
        (0, m, s) => format!("{m} min {s} s"),
        (h, m, _) => format!("{h} h {m} min"),
    }
}

/// A coordinate in a drawing: a tenth of a pixel is finer than anyone sees.
pub(super) fn pixel(value: f64) -> String {
    let text = format!("{value:.1}");
    match text.strip_suffix(".0") {
        Some("-0") => "0".to_owned(),
        Some(whole) => whole.to_owned(),
        None => text,
    }
}

fn grouped(digits: &str) -> String {
    // A thin space that does not break; four digits need none.
    if digits.len() <= 4 {
        return digits.to_owned();
    }
    let mut text = String::with_capacity(digits.len() + digits.len() / 3 * 3);
    for (place, digit) in digits.chars().enumerate() {
        if place > 0 && (digits.len() - place).is_multiple_of(3) {
            text.push('\u{202f}');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_grouped_signed_and_never_a_negative_zero() {
        assert_eq!(fixed(1234.5, 1), "1234.5");
        assert_eq!(fixed(-12_345.67, 1), "−12\u{202f}345.7");
        assert_eq!(fixed(-0.04, 1), "0.0");
        assert_eq!(fixed(f64::NAN, 2), NONE);
        assert_eq!(count(1_234_567), "1\u{202f}234\u{202f}567");
        assert_eq!(counted(1, "seed"), "1 seed");
        assert_eq!(counted(0, "run"), "0 runs");
    }

    #[test]
    fn short_numbers_keep_three_digits() {
        let shown = [0.0, 0.0421, 1.234, 45.67, 678.9, -0.000_012].map(short);
        assert_eq!(shown, ["0", "0.042", "1.23", "45.7", "679", "−1.2e−5"]);
        assert_eq!(short(f64::INFINITY), NONE);
        assert_eq!([0.0, 0.0047, 0.139, 1.25, 31.4].map(brief), ["0", "0.005", "0.14", "1.2", "31"]);
    }

    #[test]
    fn durations_and_pixels_are_brief() {
        assert_eq!([5.2, 65.0, 7260.0].map(duration), ["5 s", "1 min 5 s", "2 h 1 min"]);
        assert_eq!([1.0, -0.01, 2.55, 7.36].map(pixel), ["1", "0", "2.5", "7.4"]);
    }
}
