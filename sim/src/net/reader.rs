//! Streaming reader of `.net.xml`.

use super::{Edge, Join, Junction, Link, Net, NetError, NetLane, PhaseTimes, Program, TrafficLight};
use crate::xml::{Bounded, MOST_ATTRIBUTES};
use flate2::bufread::MultiGzDecoder;
use quick_xml::XmlVersion;
use quick_xml::events::{BytesStart, Event};
use std::collections::HashMap;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

const GZIP_MAGIC: [u8; 2] = [0x1f, 0x8b];
/// A SUMO net nests four elements deep; far more than that is not a net, and is refused before it costs memory.
const MAX_DEPTH: usize = 64;

pub(super) fn read(path: &Path) -> Result<Net, NetError> {
    let unreadable = |source| NetError::Read { path: path.to_owned(), source };
    let mut file = BufReader::with_capacity(1 << 16, File::open(path).map_err(unreadable)?);
    if file.fill_buf().map_err(unreadable)?.starts_with(&GZIP_MAGIC) {
        parse(BufReader::with_capacity(1 << 16, MultiGzDecoder::new(file)), path)
    } else {
        parse(file, path)
    }
}

pub(super) fn parse(text: impl BufRead, path: &Path) -> Result<Net, NetError> {
    let mut xml = quick_xml::Reader::from_reader(Bounded::new(text));
    let mut builder = Builder::new(path);
    let mut buffer = Vec::new();
    loop {
        buffer.clear();
        xml.get_mut().next_piece();
        let position = xml.buffer_position();
        let event = xml.read_event_into(&mut buffer).map_err(|error| builder.syntax(position, error))?;
        let result = match event {
            Event::Start(element) => {
                builder.open(&element).and_then(|()| builder.push(element.name().as_ref()))
            }
            Event::Empty(element) => builder.open(&element).map(|()| builder.close(element.name().as_ref())),
            Event::End(element) => {
                builder.open_elements.pop();
                builder.close(element.name().as_ref());
                Ok(())
            }
            Event::Eof => return builder.finish(),
            _ => Ok(()),
        };
        result.map_err(|fault| match fault {
            Fault::Net(error) => error,
            Fault::Attribute(message) => {
                NetError::Xml { path: path.to_owned(), position, message: message.to_string() }
            }
            Fault::TooManyAttributes => {
                let message = format!("an element has more than {MOST_ATTRIBUTES} attributes");
                NetError::Xml { path: path.to_owned(), position, message }
            }
        })?;
    }
}

/// What can be wrong with one element.
enum Fault {
    Net(NetError),
    /// Malformed attributes; boxed because the parser's error is much larger than the other variant.
    Attribute(Box<quick_xml::Error>),
    TooManyAttributes,
}

impl From<NetError> for Fault {
    fn from(error: NetError) -> Self {
        Self::Net(error)
    }
}

/// A connection whose edges may not have been read yet.
struct Connection {
    /// The light that controls it and the position of its letter there.
    signal: Option<(String, usize)>,
    from: (String, usize),
    to: (String, usize),
    turnaround: bool,
}

struct Builder<'p> {
    path: &'p Path,
    open_elements: Vec<String>,
    root_seen: bool,
    edges: Vec<Edge>,
    edge_of_id: HashMap<String, usize>,
    /// The ordinary edge that is open, with its lanes by index.
    edge: Option<(Edge, HashMap<usize, NetLane>)>,
    /// The traffic light whose program is open.
    program: Option<usize>,
    junctions: HashMap<String, Junction>,
    traffic_lights: Vec<TrafficLight>,
    light_of_id: HashMap<String, usize>,
    connections: Vec<Connection>,
    fault: Option<NetError>,
}

impl<'p> Builder<'p> {
    fn new(path: &'p Path) -> Self {
        Self {
            path,
            open_elements: Vec::new(),
            root_seen: false,
            edges: Vec::new(),
            edge_of_id: HashMap::new(),
            edge: None,
            program: None,
            junctions: HashMap::new(),
            traffic_lights: Vec::new(),
            light_of_id: HashMap::new(),
            connections: Vec::new(),
            fault: None,
        }
    }

    fn content(&self, what: impl Into<String>) -> NetError {
        NetError::Content { path: self.path.to_owned(), what: what.into() }
    }

    fn syntax(&self, position: u64, error: quick_xml::Error) -> NetError {
        match error {
            quick_xml::Error::Io(source) => {
                let source = std::io::Error::new(source.kind(), source.to_string());
                NetError::Read { path: self.path.to_owned(), source }
            }
            // A file that ends inside a tag or comment is cut off; the parser reports it as a syntax error.
            quick_xml::Error::Syntax(_) if self.root_seen && !self.open_elements.is_empty() => {
                NetError::Truncated { path: self.path.to_owned(), element: self.innermost() }
            }
            other => NetError::Xml { path: self.path.to_owned(), position, message: other.to_string() },
        }
    }

    fn innermost(&self) -> String {
        self.open_elements.last().cloned().unwrap_or_default()
    }

    fn push(&mut self, name: &str) -> Result<(), Fault> {
        if self.open_elements.len() >= MAX_DEPTH {
            return Err(self.content(format!("elements are nested more than {MAX_DEPTH} deep")).into());
        }
        self.open_elements.push(name.to_owned());
        Ok(())
    }

    fn open(&mut self, element: &BytesStart<'_>) -> Result<(), Fault> {
        let name = element.name();
        if !self.root_seen {
            self.root_seen = true;
            if name.as_ref() != "net" {
                return Err(
                    NetError::NotANet { path: self.path.to_owned(), root: name.as_ref().to_owned() }.into()
                );
            }
            return Ok(());
        }
        match name.as_ref() {
            "edge" => self.open_edge(&Attributes::of(element)?),
            "lane" => self.lane(&Attributes::of(element)?),
            "junction" => self.junction(&Attributes::of(element)?),
            "tlLogic" => self.open_program(&Attributes::of(element)?),
            "phase" => self.phase(&Attributes::of(element)?),
            "connection" => self.connection(&Attributes::of(element)?),
            _ => Ok(()),
        }
    }

    fn close(&mut self, name: &str) {
        match name {
            "edge" => self.close_edge(),
            "tlLogic" => self.program = None,
            _ => {}
        }
    }

    fn required(&self, attributes: &Attributes, key: &str, element: &str) -> Result<String, NetError> {
        attributes.get(key).map(str::to_owned).ok_or_else(|| {
            let id = attributes.get("id").map(|id| format!(" {id:?}")).unwrap_or_default();
            self.content(format!("<{element}>{id} has no {key}"))
        })
    }

    fn number<T: std::str::FromStr>(
        &self,
        attributes: &Attributes,
        key: &str,
        element: &str,
    ) -> Result<T, NetError> {
        let text = self.required(attributes, key, element)?;
        text.trim().parse().map_err(|_| {
            let id = attributes.get("id").map(|id| format!(" {id:?}")).unwrap_or_default();
            self.content(format!(
                "<{element}>{id} has {key}={text:?}, which is not a number of the kind expected"
            ))
        })
    }

    /// A number that is finite and not negative.
    fn measure(&self, attributes: &Attributes, key: &str, element: &str) -> Result<f64, NetError> {
        let value: f64 = self.number(attributes, key, element)?;
        if value.is_finite() && value >= 0.0 {
            Ok(value)
        } else {
            let id = attributes.get("id").unwrap_or_default();
            Err(self.content(format!("<{element}> {id:?} has {key}={value}, which cannot be")))
        }
    }

    /// Positions `x,y` or `x,y,z`, separated by spaces; none if the attribute is missing.
    fn shape(&self, attributes: &Attributes, element: &str) -> Result<Vec<[f64; 2]>, NetError> {
        let Some(text) = attributes.get("shape") else { return Ok(Vec::new()) };
        let position = |position: &str| {
            let mut coordinates =
                position.split(',').map(|text| text.parse().ok().filter(|x: &f64| x.is_finite()));
            Some([coordinates.next()??, coordinates.next()??])
        };
        text.split_whitespace().map(position).collect::<Option<_>>().ok_or_else(|| {
            let id = attributes.get("id").unwrap_or_default();
            self.content(format!("<{element}> {id:?} has shape={text:?}, which is no list of positions"))
        })
    }

    fn open_edge(&mut self, attributes: &Attributes) -> Result<(), Fault> {
        let id = self.required(attributes, "id", "edge")?;
        // Internal edges, crossings and walking areas all have ids of this form.
        if id.starts_with(':') {
            return Ok(());
        }
        let to = attributes.get("to").unwrap_or_default().to_owned();
        self.edge = Some((Edge { id, to, lanes: Vec::new() }, HashMap::new()));
        Ok(())
    }

    fn lane(&mut self, attributes: &Attributes) -> Result<(), Fault> {
        if self.edge.is_none() {
            return Ok(());
        }
        let index: usize = self.number(attributes, "index", "lane")?;
        let lane = NetLane {
            id: self.required(attributes, "id", "lane")?,
            length: self.measure(attributes, "length", "lane")?,
            speed: self.measure(attributes, "speed", "lane")?,
            shape: self.shape(attributes, "lane")?,
        };
        if let Some((_, lanes)) = &mut self.edge {
            lanes.insert(index, lane);
        }
        Ok(())
    }

    fn close_edge(&mut self) {
        let Some((mut edge, mut lanes)) = self.edge.take() else { return };
        edge.lanes = (0..lanes.len()).map_while(|index| lanes.remove(&index)).collect();
        if !lanes.is_empty() && self.fault.is_none() {
            self.fault =
                Some(self.content(format!("the lanes of edge {:?} are not numbered from 0", edge.id)));
        }
        self.edge_of_id.insert(edge.id.clone(), self.edges.len());
        self.edges.push(edge);
    }

    fn junction(&mut self, attributes: &Attributes) -> Result<(), Fault> {
        let id = self.required(attributes, "id", "junction")?;
        if id.starts_with(':') {
            return Ok(());
        }
        let junction = Junction {
            x: self.number(attributes, "x", "junction")?,
            y: self.number(attributes, "y", "junction")?,
        };
        if !(junction.x.is_finite() && junction.y.is_finite()) {
            return Err(self.content(format!("junction {id:?} has no finite position")).into());
        }
        self.junctions.insert(id, junction);
        Ok(())
    }

    fn open_program(&mut self, attributes: &Attributes) -> Result<(), Fault> {
        let id = self.required(attributes, "id", "tlLogic")?;
        let next = self.traffic_lights.len();
        let light = *self.light_of_id.entry(id.clone()).or_insert(next);
        if light == next {
            self.traffic_lights.push(TrafficLight { id, ..TrafficLight::default() });
        }
        let program = attributes.get("programID").unwrap_or("0").to_owned();
        self.traffic_lights[light].programs.push(Program {
            id: program,
            states: Vec::new(),
            times: Vec::new(),
        });
        self.program = Some(light);
        Ok(())
    }

    fn phase(&mut self, attributes: &Attributes) -> Result<(), Fault> {
        let Some(light) = self.program else { return Ok(()) };
        let state = self.required(attributes, "state", "phase")?;
        // Only SUMO's own programs need these; who sets the signals himself can do with a net that has odd ones.
        let seconds = |key| {
            attributes.get(key)?.trim().parse().ok().filter(|time: &f64| time.is_finite() && *time > 0.0)
        };
        let times = PhaseTimes {
            duration: seconds("duration"),
            shortest: seconds("minDur"),
            longest: seconds("maxDur"),
        };
        let light = &self.traffic_lights[light];
        if let Some(letter) = state.chars().find(|letter| !"rugGysoO".contains(*letter)) {
            let what =
                format!("traffic light {:?} has a phase with {letter:?}, which is no signal", light.id);
            return Err(self.content(what).into());
        }
        let index = self.light_of_id[&light.id];
        if let Some(program) = self.traffic_lights[index].programs.last_mut() {
            program.states.push(state);
            program.times.push(times);
        }
        Ok(())
    }

    fn connection(&mut self, attributes: &Attributes) -> Result<(), Fault> {
        let turnaround = matches!(attributes.get("dir"), Some("t" | "T"));
        let Some(light) = attributes.get("tl") else {
            // Only what is behind and beyond junctions is read from these, so that an odd one is no reason to refuse a net.
            let end =
                |edge, lane| Some((attributes.get(edge)?.to_owned(), attributes.get(lane)?.parse().ok()?));
            if let (Some(from), Some(to), false) = (end("from", "fromLane"), end("to", "toLane"), turnaround)
                && !from.0.starts_with(':')
                && !to.0.starts_with(':')
            {
                self.connections.push(Connection { signal: None, from, to, turnaround });
            }
            return Ok(());
        };
        let from = self.required(attributes, "from", "connection")?;
        let to = self.required(attributes, "to", "connection")?;
        // Pedestrian crossings are links too; they carry no vehicles.
        if from.starts_with(':') || to.starts_with(':') {
            return Ok(());
        }
        self.connections.push(Connection {
            signal: Some((light.to_owned(), self.number(attributes, "linkIndex", "connection")?)),
            from: (from, self.number(attributes, "fromLane", "connection")?),
            to: (to, self.number(attributes, "toLane", "connection")?),
            turnaround,
        });
        Ok(())
    }

    fn end_of_connection(&self, (edge, lane): &(String, usize)) -> Result<(usize, usize), NetError> {
        let index = *self
            .edge_of_id
            .get(edge)
            .ok_or_else(|| self.content(format!("a connection names edge {edge:?}, which does not exist")))?;
        if *lane >= self.edges[index].lanes.len() {
            let what = format!("a connection names lane {lane} of edge {edge:?}, which has no such lane");
            return Err(self.content(what));
        }
        Ok((index, *lane))
    }

    fn finish(mut self) -> Result<Net, NetError> {
        if !self.open_elements.is_empty() {
            return Err(NetError::Truncated { path: self.path.to_owned(), element: self.innermost() });
        }
        if !self.root_seen {
            return Err(NetError::NotANet { path: self.path.to_owned(), root: String::new() });
        }
        if let Some(fault) = self.fault.take() {
            return Err(fault);
        }
        let mut joins = Vec::new();
        for connection in std::mem::take(&mut self.connections) {
            let ends =
                || Ok((self.end_of_connection(&connection.from)?, self.end_of_connection(&connection.to)?));
            let turnaround = connection.turnaround;
            // A light without a program in the net (a rail signal, say) is not one that can be controlled.
            let signal = connection.signal.as_ref();
            match signal.and_then(|(light, index)| Some((*self.light_of_id.get(light)?, *index))) {
                Some((light, index)) => {
                    let (from, to) = ends()?;
                    self.traffic_lights[light].links.push(Link { index, from, to, turnaround });
                }
                None => {
                    if let (false, Ok::<_, NetError>((from, to))) = (turnaround, ends()) {
                        joins.push(Join { from, to });
                    }
                }
            }
        }
        for light in &mut self.traffic_lights {
            light.links.sort_by_key(|link| link.index);
        }
        Ok(Net {
            path: self.path.to_owned(),
            edges: self.edges,
            junctions: self.junctions,
            traffic_lights: self.traffic_lights,
            joins,
            edge_of_id: self.edge_of_id,
        })
    }
}

/// Attributes of one element, unescaped.
struct Attributes(Vec<(String, String)>);

impl Attributes {
    fn of(element: &BytesStart<'_>) -> Result<Self, Fault> {
        let mut attributes = Vec::new();
        for attribute in element.attributes() {
            if attributes.len() == MOST_ATTRIBUTES {
                return Err(Fault::TooManyAttributes);
            }
            let attribute = attribute.map_err(|error| Fault::Attribute(Box::new(error.into())))?;
            let value = attribute
                .normalized_value(XmlVersion::Implicit1_0)
                .map_err(|error| Fault::Attribute(Box::new(error)))?;
            attributes.push((attribute.key.as_ref().to_owned(), value.into_owned()));
        }
        Ok(Self(attributes))
    }

    fn get(&self, key: &str) -> Option<&str> {
        self.0.iter().find(|(name, _)| name == key).map(|(_, value)| value.as_str())
    }
}
