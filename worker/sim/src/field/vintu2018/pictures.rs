//! Pictures to look at: `FURROW_PICTURES=folder cargo test -p furrow-sim draws_a_field_and_a_scan -- --ignored`.

use std::fmt::Write as _;
use std::path::Path;

use super::*;
use crate::field::PlantKind;
use crate::lidar::frame::Frame;
use crate::lidar::{Fx10, Fx10Params};

const PX_PER_M: f64 = 40.0;

struct Picture(String);

impl Picture {
    fn new([x0, y0]: [f64; 2], [x1, y1]: [f64; 2]) -> Self {
        let (width, height) = ((x1 - x0) * PX_PER_M, (y1 - y0) * PX_PER_M);
        let head = format!(
            "<svg xmlns='http://www.w3.org/2000/svg' width='{width:.0}' height='{height:.0}' viewBox='{x0} {} {} {}'>\n\
             <rect x='{x0}' y='{}' width='100%' height='100%' fill='#fbf7ee'/>\n",
            -y1,
            x1 - x0,
            y1 - y0,
            -y1
        );
        Self(head)
    }

    fn circle(&mut self, [x, y]: [f64; 2], radius: f64, style: &str) {
        writeln!(self.0, "<circle cx='{x:.3}' cy='{:.3}' r='{radius:.4}' style='{style}'/>", -y).unwrap();
    }

    fn save(mut self, folder: &str, name: &str) {
        self.0.push_str("</svg>\n");
        std::fs::write(Path::new(folder).join(format!("{name}.svg")), self.0).unwrap();
    }
}

fn hue(height_m: f64, top_m: f64) -> String {
    format!("fill:hsl({:.0},80%,42%)", 240.0 - 240.0 * (height_m / top_m).clamp(0.0, 1.0))
}

fn top_view(field: &Field, nursery: &Nursery) -> Picture {
    let [from, to] = extent_m(&nursery.map);
    let mut picture = Picture::new([-3.0, from[1] - 2.0], [to[0] + 3.0, to[1] + 2.0]);
    for j in 0..((to[1] - from[1] + 4.0) * 5.0) as i32 {
        for i in 0..((to[0] + 6.0) * 5.0) as i32 {
            let (x, y) = (-3.0 + 0.2 * f64::from(i), from[1] - 2.0 + 0.2 * f64::from(j));
            let relief =
                nursery.terrain.height_m(x, y) - nursery.terrain.slope()[0] * x - nursery.terrain.slope()[1] * y;
            let light = 78.0 + 120.0 * relief;
            writeln!(
                picture.0,
                "<rect x='{x:.2}' y='{:.2}' width='0.2' height='0.2' style='fill:hsl(35,30%,{light:.0}%)'/>",
                -y - 0.2
            )
            .unwrap();
        }
    }
    for (plant, shape) in field.plants.iter().zip(&nursery.shapes) {
        let colour = if plant.kind == PlantKind::Crop { "#2c8a3b" } else { "#c79a1b" };
        let at = [plant.x_m, plant.y_m];
        picture.circle(at, plant.radius_m, &format!("fill:{colour};fill-opacity:0.45"));
        picture.circle(at, 0.5 * plant.radius_m, "fill:none;stroke:#14551f;stroke-width:0.01");
        for pole in shape.poles.iter().flatten() {
            picture.circle([pole.x_m, pole.y_m], pole.radius_m, "fill:#4a2b12");
        }
    }
    for lane in 0..nursery.map.lanes() {
        let colour = if nursery.passable_lane(lane, 0.9) { "#1565c0" } else { "#c62828" };
        picture.circle([-0.7, nursery.map.lane_y_m(lane)], 0.12, &format!("fill:{colour}"));
    }
    picture.circle([field.start.x_m, field.start.y_m], 0.2, "fill:black");
    picture
}

/// From above, and below that from the side, all points of ten scans along the first lane.
fn scans(nursery: &Nursery, pattern_scans: u32) -> Picture {
    let params = Fx10Params::default();
    let mut lidar = Fx10::new(&params);
    let mut random = Stream::new(1, "lidar");
    let top_m = nursery.max_height_m.min(2.5);
    let mut picture = Picture::new([-1.0, -7.0], [16.0, 6.0]);
    for i in 0..pattern_scans {
        let at = Pose { x_m: -1.0 + 0.3 * f64::from(i), y_m: 0.0, heading_rad: 0.0 };
        let frame = Frame::of_lidar(params.mount(), at, nursery.terrain.ground(at));
        for p in lidar.scan(nursery, at, at, &mut random).points {
            let turned = frame.turn([p.x, p.y, p.z]);
            let [x, y, z] = [0, 1, 2].map(|k| frame.origin[k] + turned[k]);
            let above = z - nursery.terrain.height_m(x, y);
            let style = if above < 0.05 { "fill:#b9a57f".to_owned() } else { hue(above, top_m) };
            picture.circle([x, y], 0.018, &style);
            picture.circle([x, z - 6.5], 0.018, &style);
        }
    }
    picture
}

#[test]
#[ignore = "draws pictures for people"]
fn draws_a_field_and_a_scan() {
    let folder = std::env::var("FURROW_PICTURES").expect("FURROW_PICTURES names a folder");
    let garden = Vintu2018Params { site: Site::RealGarden, ..Default::default() };
    let numbered = |number| Vintu2018Params { nursery: number, ..Default::default() };
    for params in [0, 10, 24, 47, 52, 68, 97].map(numbered).into_iter().chain([garden]) {
        let field = build(&params, 1);
        let nursery = field.nursery.as_ref().unwrap();
        top_view(&field, nursery).save(&folder, &format!("{}-field", field.name));
        scans(nursery, 1).save(&folder, &format!("{}-scan", field.name));
        scans(nursery, 20).save(&folder, &format!("{}-scans", field.name));
    }
}
