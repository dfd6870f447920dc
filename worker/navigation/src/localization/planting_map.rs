//! What is known of a nursery beforehand: where plants were planted. Vintu (2018), section 3.2.2.

/// A rectangle of rows, planted at fixed distances.
///
/// Its frame: x along the rows, 0 at their first plants; y = 0 in the middle of the first lane, at whose beginning the
/// robot starts, heading along x. Lane i lies between rows i and i + 1, at y = i times the row distance to the left or right.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlantingMap {
    /// From row to row \[m\].
    pub row_distance_m: f64,
    /// From plant to plant in a row \[m\].
    pub planting_distance_m: f64,
    /// At least 2.
    pub rows: u32,
    /// At least 2.
    pub plants_per_row: u32,
    /// Whether the second lane lies to the left of the first one, seen along x: the robot starts in the right corner.
    pub lanes_to_the_left: bool,
}

impl PlantingMap {
    /// From the first plant of a row to its last \[m\].
    #[must_use]
    pub fn row_length_m(&self) -> f64 {
        f64::from(self.plants_per_row.saturating_sub(1)) * self.planting_distance_m
    }

    /// Lanes between rows.
    #[must_use]
    pub const fn lanes(&self) -> u32 {
        self.rows.saturating_sub(1)
    }

    /// y of the middle of lane `lane` \[m\].
    #[must_use]
    pub fn lane_y_m(&self, lane: u32) -> f64 {
        self.towards_next() * f64::from(lane) * self.row_distance_m
    }

    /// y of row `row` \[m\].
    #[must_use]
    pub fn row_y_m(&self, row: u32) -> f64 {
        self.towards_next() * (f64::from(row) - 0.5) * self.row_distance_m
    }

    /// 1 where y grows from lane to lane, else -1.
    #[must_use]
    pub const fn towards_next(&self) -> f64 {
        if self.lanes_to_the_left { 1.0 } else { -1.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_lane_lies_between_the_first_two_rows_whatever_the_corner() {
        for lanes_to_the_left in [true, false] {
            let map = PlantingMap {
                row_distance_m: 1.3,
                planting_distance_m: 0.4,
                rows: 5,
                plants_per_row: 21,
                lanes_to_the_left,
            };
            assert_eq!((map.lane_y_m(0), map.lanes()), (0.0, 4));
            assert!((map.row_length_m() - 8.0).abs() < 1e-12);
            assert!((map.row_y_m(0) + map.row_y_m(1)).abs() < 1e-12);
            assert_eq!(map.lane_y_m(2), 2.6 * map.towards_next());
        }
    }
}
