//! Axes of a cloud of points: eigenvectors of its scatter.

use super::Point3;

/// Sweeps of rotations; three by three matrices need about five.
const SWEEPS: usize = 12;

/// A point, and a unit vector.
pub(super) type Axis = [[f64; 3]; 2];

/// The centroid of `points`, and the direction in which they scatter most; none of fewer than two different points.
pub(super) fn longest_axis(points: impl Iterator<Item = Point3> + Clone) -> Option<Axis> {
    axis(points, |a, b| a > b)
}

/// The centroid of `points`, and the direction in which they scatter least, such as the normal of a plane.
pub(super) fn shortest_axis(points: impl Iterator<Item = Point3> + Clone) -> Option<Axis> {
    axis(points, |a, b| a < b)
}

fn axis(points: impl Iterator<Item = Point3> + Clone, is_better: impl Fn(f64, f64) -> bool) -> Option<Axis> {
    let mut n = 0.0;
    let mut centre = [0.0; 3];
    for point in points.clone() {
        n += 1.0;
        centre = [centre[0] + point.x, centre[1] + point.y, centre[2] + point.z];
    }
    let centre = centre.map(|sum| sum / n);
    let mut scatter = [[0.0; 3]; 3];
    for point in points {
        let d = [point.x - centre[0], point.y - centre[1], point.z - centre[2]];
        for (row, a) in scatter.iter_mut().zip(d) {
            for (sum, b) in row.iter_mut().zip(d) {
                *sum += a * b;
            }
        }
    }
    let scale = scatter[0][0] + scatter[1][1] + scatter[2][2];
    // What rounding scatters is no scatter.
    let rounding = 1e-24 * n * centre.iter().map(|part| part * part).sum::<f64>();
    if !(scale > rounding && scale.is_finite()) {
        return None;
    }
    let (values, vectors) = jacobi(scatter);
    let best = (1..3).fold(0, |best, i| if is_better(values[i], values[best]) { i } else { best });
    Some([centre, [vectors[0][best], vectors[1][best], vectors[2][best]]])
}

/// Eigenvalues, and eigenvectors as columns, of a symmetric matrix by Jacobi's rotations.
fn jacobi(mut a: [[f64; 3]; 3]) -> ([f64; 3], [[f64; 3]; 3]) {
    let mut v = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    for _ in 0..SWEEPS {
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            if a[p][q] == 0.0 {
                continue;
            }
            let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
            let t = f64::copysign(1.0, theta) / (theta.abs() + (theta * theta + 1.0).sqrt());
            let c = 1.0 / (t * t + 1.0).sqrt();
            let s = t * c;
            let (row_p, row_q) = (a[p], a[q]);
            a[p] = [0, 1, 2].map(|k| c * row_p[k] - s * row_q[k]);
            a[q] = [0, 1, 2].map(|k| s * row_p[k] + c * row_q[k]);
            for row in a.iter_mut().chain(&mut v) {
                (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
            }
        }
    }
    ([a[0][0], a[1][1], a[2][2]], v)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn eigenvectors_are_turned_into_multiples_of_themselves(parts in prop::array::uniform6(-10.0..10.0_f64)) {
            let [a, b, c, d, e, f] = parts;
            let m = [[a, b, c], [b, d, e], [c, e, f]];
            let (values, v) = jacobi(m);
            for i in 0..3 {
                let x = [v[0][i], v[1][i], v[2][i]];
                prop_assert!((x.iter().map(|part| part * part).sum::<f64>() - 1.0).abs() < 1e-12);
                for (row, part) in m.iter().zip(x) {
                    let product: f64 = row.iter().zip(x).map(|(a, b)| a * b).sum();
                    prop_assert!((product - values[i] * part).abs() < 1e-10);
                }
            }
        }
    }

    #[test]
    fn points_of_a_plane_give_its_normal_and_one_point_no_axis() {
        let points: Vec<_> = (0..25)
            .map(|i| (f64::from(i % 5), f64::from(i / 5)))
            .map(|(x, y)| Point3 { x, y, z: 0.2 * x - 0.1 * y + 1.0 })
            .collect();
        let [_, normal] = shortest_axis(points.iter().copied()).unwrap();
        let length = (0.04 + 0.01 + 1.0_f64).sqrt();
        let expected = [-0.2 / length, 0.1 / length, 1.0 / length];
        let sign = normal[2].signum();
        assert!(normal.iter().zip(expected).all(|(is, should)| (sign * is - should).abs() < 1e-12), "{normal:?}");
        assert_eq!(longest_axis(std::iter::repeat_n(points[3], 9)), None);
        assert_eq!(longest_axis(std::iter::empty()), None);
    }
}
