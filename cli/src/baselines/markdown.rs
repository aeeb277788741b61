//! Lines, tables and names in Markdown, whatever the names hold.

/// Digits of a hash that tell files apart.
const HASH_DIGITS: usize = 12;

pub(super) fn short(hash: &str) -> String {
    hash.chars().take(HASH_DIGITS).collect()
}

/// Text as it stands; whatever it holds ends neither the code nor the line.
pub(super) fn code(text: &str) -> String {
    let text = one_line(text);
    if text.contains('`') { format!("`` {text} ``") } else { format!("`{text}`") }
}

/// Text in a heading, where nothing in it is formatting.
pub(super) fn heading(text: &str) -> String {
    one_line(text).chars().fold(String::new(), |mut text, letter| {
        if "\\`*_[]<>#|&".contains(letter) {
            text.push('\\');
        }
        text.push(letter);
        text
    })
}

pub(super) fn one_line(text: &str) -> String {
    text.split(|letter: char| letter.is_whitespace() || letter.is_control())
        .filter(|word| !word.is_empty())
        .collect::<Vec<_>>()
        .join(" ")
}

pub(super) fn row(page: &mut String, cells: &[String]) {
    // A bar would begin a cell, in code as well.
    let cells: Vec<_> = cells.iter().map(|cell| cell.replace('|', "\\|")).collect();
    line(page, &format!("| {} |", cells.join(" | ")));
}

pub(super) fn line(page: &mut String, text: &str) {
    page.push_str(text);
    page.push('\n');
}
