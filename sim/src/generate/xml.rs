//! Writing SUMO's XML files.

use quick_xml::events::{BytesDecl, BytesEnd, BytesStart, Event};
use quick_xml::writer::Writer;
use std::fmt::Display;
use std::io::{self, Write};

/// An XML document under way; [`XmlFile::finish`] closes it.
pub(crate) struct XmlFile<W: Write> {
    writer: Writer<W>,
    root: String,
}

/// One attribute: its name and what it says.
pub(crate) type Attribute<'a> = (&'a str, &'a dyn Display);

impl<W: Write> XmlFile<W> {
    /// Starts a document with this root element.
    pub(crate) fn start(target: W, root: &str) -> io::Result<Self> {
        let mut writer = Writer::new_with_indent(target, b' ', 4);
        writer.write_event(Event::Decl(BytesDecl::new("1.0", Some("UTF-8"), None)))?;
        writer.write_event(Event::Start(BytesStart::new(root)))?;
        Ok(Self { writer, root: root.to_owned() })
    }

    /// An element without children.
    pub(crate) fn element(&mut self, name: &str, attributes: &[Attribute<'_>]) -> io::Result<()> {
        self.writer.write_event(Event::Empty(tag(name, attributes)))
    }

    /// An element whose children `inside` writes.
    pub(crate) fn nested(
        &mut self,
        name: &str,
        attributes: &[Attribute<'_>],
        inside: impl FnOnce(&mut Self) -> io::Result<()>,
    ) -> io::Result<()> {
        self.writer.write_event(Event::Start(tag(name, attributes)))?;
        inside(self)?;
        self.writer.write_event(Event::End(BytesEnd::new(name)))
    }

    /// Closes the root and hands the target back, everything written to it.
    pub(crate) fn finish(mut self) -> io::Result<W> {
        self.writer.write_event(Event::End(BytesEnd::new(self.root.as_str())))?;
        let mut target = self.writer.into_inner();
        target.write_all(b"\n")?;
        target.flush()?;
        Ok(target)
    }
}

fn tag<'a>(name: &'a str, attributes: &[Attribute<'_>]) -> BytesStart<'a> {
    let mut tag = BytesStart::new(name);
    for (key, value) in attributes {
        tag.push_attribute((*key, value.to_string().as_str()));
    }
    tag
}

/// A number as SUMO's files have it: at most three decimals, none where they say nothing.
pub(crate) fn number(value: f64) -> String {
    let text = format!("{value:.3}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    // Rounding may leave a negative zero.
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attributes_are_escaped() {
        let mut xml = XmlFile::start(Vec::new(), "nodes").unwrap();
        xml.element("node", &[("id", &"a<b>&\"c\"")]).unwrap();
        let text = String::from_utf8(xml.finish().unwrap()).unwrap();
        assert!(text.contains("id=\"a&lt;b&gt;&amp;&quot;c&quot;\""), "{text}");
        assert!(text.ends_with("</nodes>\n"), "{text}");
    }

    #[test]
    fn numbers_are_short() {
        for (value, text) in
            [(200.0, "200"), (13.89, "13.89"), (-0.0001, "0"), (0.1 + 0.2, "0.3"), (11.111, "11.111")]
        {
            assert_eq!(number(value), text);
        }
    }
}
