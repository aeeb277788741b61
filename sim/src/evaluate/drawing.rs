//! From a net to the drawing of a report page.

use super::details::{EdgeDrawing, NetworkDrawing, SignalDrawing};
use crate::layout::NetworkLayout;
use crate::net::{Edge, Net};

/// Centimetres are finer than any screen shows.
const PER_METRE: f64 = 100.0;

impl NetworkDrawing {
    pub(super) fn new(net: &Net, layout: &NetworkLayout) -> Self {
        let signals = layout.intersections.iter().map(|intersection| SignalDrawing {
            id: intersection.id.clone(),
            x: rounded(f64::from(intersection.position.0)),
            y: rounded(f64::from(intersection.position.1)),
        });
        Self { edges: net.edges.iter().map(edge).collect(), signals: signals.collect() }
    }
}

fn edge(edge: &Edge) -> EdgeDrawing {
    let middle = edge.lanes.get(edge.lanes.len() / 2);
    EdgeDrawing {
        id: edge.id.clone(),
        lanes: u32::try_from(edge.lanes.len()).unwrap_or(u32::MAX),
        shape: middle
            .map(|lane| lane.shape.iter().map(|point| point.map(rounded)).collect())
            .unwrap_or_default(),
    }
}

fn rounded(metres: f64) -> f64 {
    (metres * PER_METRE).round() / PER_METRE
}

#[cfg(test)]
mod tests {
    use super::*;
    use cross_config::EnvConfig;
    use std::path::Path;

    #[test]
    fn roads_are_drawn_along_their_middle_lane_and_signals_where_they_are() {
        let text = r#"<net>
            <edge id="in" from="W" to="J">
                <lane id="in_0" index="0" speed="9" length="99" shape="-100,-1 0,-1"/>
                <lane id="in_1" index="1" speed="9" length="99" shape="-100,2 -50.123,2.5,7 0,2"/>
            </edge>
            <edge id="out" from="J" to="E"><lane id="out_0" index="0" speed="9" length="99"/></edge>
            <tlLogic id="J"><phase state="Gr"/><phase state="rG"/></tlLogic>
            <junction id="J" x="1.25" y="2"/>
            <connection from="in" to="out" fromLane="0" toLane="0" tl="J" linkIndex="0"/>
            <connection from="in" to="out" fromLane="1" toLane="0" tl="J" linkIndex="1"/>
        </net>"#;
        let net = Net::parse(text.as_bytes(), Path::new("town.net.xml")).unwrap();
        let layout = NetworkLayout::from_net(&net, &EnvConfig::default()).unwrap();
        let drawing = NetworkDrawing::new(&net, &layout);
        assert_eq!(drawing.signals, [SignalDrawing { id: "J".to_owned(), x: 1.25, y: 2.0 }]);
        assert_eq!((drawing.edges[0].id.as_str(), drawing.edges[0].lanes), ("in", 2));
        assert_eq!(drawing.edges[0].shape, [[-100.0, 2.0], [-50.12, 2.5], [0.0, 2.0]]);
        assert_eq!(drawing.edges[1].shape, [[0.0; 2]; 0], "a net without shapes can still be evaluated");
    }
}
