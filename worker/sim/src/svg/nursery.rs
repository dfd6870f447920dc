//! A run in a nursery, as figure 4.5 of Vintu (2018), and the graph of its poses over the map, as figure 4.18 there.

use super::{CROP, DAMAGED, Mark, Sheet, WEED};
use crate::Pose;
use crate::field::{Field, Nursery, Plant, PlantKind};
use crate::run::LocatedNode;

const MISSING: &str = "#9e9e9e";
const NODE: &str = "#f9a825";
const EDGE: &str = "#1f4e9c";
const MATCHED: &str = "#8e24aa";

/// Crowns with the circles that a robot must spare, damaged plants red, and the path.
pub(super) fn run(field: &Field, path: &[Pose], damaged: &[usize], caption: &str) -> String {
    let mut sheet = Sheet::new(field, path);
    sheet.draw_axes();
    for (i, plant) in field.plants.iter().enumerate() {
        sheet.draw_crown(plant, damaged.contains(&i));
    }
    sheet.draw_path(path);
    sheet.draw_start(&field.start);
    sheet.draw_caption(caption);
    let marks: [(&str, bool, f64, Mark); 5] = [
        ("start and heading", true, 0.6, |sheet, place| sheet.draw_start_at(place, 0.0)),
        ("travel", true, 0.2, |sheet, place| sheet.draw_arrow(place, 0.0)),
        ("plant: crown, half its radius", true, 0.2, |sheet, place| sheet.draw_circles(place, 0.14, CROP)),
        ("damaged plant", !damaged.is_empty(), 0.2, |sheet, place| sheet.draw_circles(place, 0.14, DAMAGED)),
        ("weed", has_weeds(field), 0.15, |sheet, place| sheet.dot(place, 0.05, WEED)),
    ];
    sheet.draw_marks(&marks);
    sheet.svg + "</svg>\n"
}

fn has_weeds(field: &Field) -> bool {
    field.plants.iter().any(|plant| plant.kind == PlantKind::Weed)
}

/// The map's planting positions, the nodes and edges of the graph, and what of the rows was matched from them.
pub(super) fn graph((field, nursery): (&Field, &Nursery), nodes: &[LocatedNode], caption: &str) -> String {
    let path: Vec<Pose> = nodes.iter().map(|node| node.map_from_robot).collect();
    let mut sheet = Sheet::new(field, &path);
    sheet.draw_axes();
    let positions =
        (0..nursery.map.rows).flat_map(|row| (0..nursery.map.plants_per_row).map(move |plant| (row, plant)));
    for ((row, plant), present) in positions.zip(&nursery.presence) {
        let place = sheet.place(f64::from(plant) * nursery.map.planting_distance_m, nursery.map.row_y_m(row));
        sheet.dot(place, 0.045, if *present { CROP } else { MISSING });
    }
    nodes.iter().flat_map(|node| &node.matched_m).for_each(|ends| sheet.draw_line(*ends, MATCHED, 0.03));
    for pair in path.windows(2) {
        sheet.draw_line([[pair[0].x_m, pair[0].y_m], [pair[1].x_m, pair[1].y_m]], EDGE, 0.02);
    }
    for pose in &path {
        let place = sheet.place(pose.x_m, pose.y_m);
        sheet.dot(place, 0.035, NODE);
    }
    sheet.draw_caption(caption);
    let marks: [(&str, bool, f64, Mark); 5] = [
        ("node", true, 0.15, |sheet, place| sheet.dot(place, 0.06, NODE)),
        ("edge", true, 0.3, |sheet, (x, y)| sheet.stroke([(x, y), (x + 0.25, y)], EDGE, 0.02)),
        ("part of a row that was matched", true, 0.3, |sheet, (x, y)| {
            sheet.stroke([(x, y), (x + 0.25, y)], MATCHED, 0.03);
        }),
        ("plant", true, 0.15, |sheet, place| sheet.dot(place, 0.06, CROP)),
        ("missing plant", true, 0.15, |sheet, place| sheet.dot(place, 0.06, MISSING)),
    ];
    sheet.draw_marks(&marks);
    sheet.svg + "</svg>\n"
}

impl Sheet {
    fn draw_crown(&mut self, plant: &Plant, damaged: bool) {
        let place = self.place(plant.x_m, plant.y_m);
        let radius = plant.radius_m / self.unit_m;
        match plant.kind {
            PlantKind::Crop => self.draw_circles(place, radius, if damaged { DAMAGED } else { CROP }),
            PlantKind::Weed => self.dot(place, radius.max(0.02), WEED),
        }
    }

    /// A crown, and the circle of half its radius.
    fn draw_circles(&mut self, (x, y): (f64, f64), radius: f64, colour: &str) {
        let outer = radius.max(0.03);
        self.push(format_args!(
            "<circle cx=\"{x:.3}\" cy=\"{y:.3}\" r=\"{outer:.3}\" fill=\"{colour}\" fill-opacity=\"0.25\"/>\
             <circle cx=\"{x:.3}\" cy=\"{y:.3}\" r=\"{:.3}\" fill=\"{colour}\"/>",
            0.5 * outer
        ));
    }

    fn draw_line(&mut self, [[x0_m, y0_m], [x1_m, y1_m]]: [[f64; 2]; 2], colour: &str, width: f64) {
        let ends = [self.place(x0_m, y0_m), self.place(x1_m, y1_m)];
        self.stroke(ends, colour, width);
    }

    fn stroke(&mut self, [(x0, y0), (x1, y1)]: [(f64, f64); 2], colour: &str, width: f64) {
        self.push(format_args!(
            "<path d=\"M {x0:.3} {y0:.3} L {x1:.3} {y1:.3}\" stroke=\"{colour}\" stroke-width=\"{width}\" fill=\"none\"/>"
        ));
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use crate::run::LocatedNode;
    use crate::scenario::tests::{base, nursery};
    use crate::{Pose, Probe, Scenario, Seed, simulate, svg};

    #[derive(Default)]
    struct Watch(Vec<Pose>, Vec<LocatedNode>);

    impl Probe for Watch {
        fn pose(&mut self, _time_s: f64, pose: Pose) {
            self.0.push(pose);
        }
        fn located(&mut self, node: &LocatedNode) {
            self.1.push(node.clone());
        }
    }

    #[test]
    fn a_run_shows_every_plant_and_its_graph_every_node() {
        let mut value = nursery();
        value["field"]["nursery"] = json!(7);
        value["limits"]["max_time_s"] = json!(10.0);
        let scenario = Scenario::from_value(value).unwrap();
        let mut watch = Watch::default();
        let result = simulate(&scenario, Seed(1), &mut watch);
        let Watch(path, nodes) = watch;
        assert!(nodes.len() > 20 && nodes.iter().any(|node| node.matched_m.len() >= 2), "{}", nodes.len());
        assert!(nodes.iter().flat_map(|node| &node.matched_m).all(|[from, to]| from[1] == to[1] && from[0] <= to[0]));
        let plants = scenario.field.build(1).plants.len();
        let drawing = svg::trajectory(&scenario, Seed(1), &path, &result);
        assert!(drawing.matches("<circle").count() > plants && drawing.contains("localization pose-graph"));
        let graph = svg::pose_graph(&scenario, Seed(1), &nodes, &result).unwrap();
        // A mark of its own in the key, too.
        assert_eq!(graph.matches(super::NODE).count(), nodes.len() + 1);
        assert!(graph.ends_with("</svg>\n"));
        assert_eq!(svg::pose_graph(&scenario, Seed(1), &[], &result), None, "without localization");
        assert_eq!(svg::pose_graph(&Scenario::from_value(base()).unwrap(), Seed(1), &nodes, &result), None);
    }
}
