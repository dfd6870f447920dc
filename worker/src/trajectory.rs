//! Paths of runs as short texts.
//!
//! A trajectory is the true pose every 0.05 s from 0 s on. Positions are rounded to 2^-14 m (61 um) and headings to
//! 2^-16 rad (15 urad), so a decoded pose is within 0.031 mm and 8 urad of the recorded one. Each column holds the
//! second differences of its integers, which a robot's inertia keeps small, as variable-length bytes; all of it is
//! deflated and written as hexadecimal digits, after a byte with the form's version.

use furrow_sim::{Pose, Probe};
use miniz_oxide::deflate::compress_to_vec;
use miniz_oxide::inflate::decompress_to_vec_with_limit;

/// A trajectory has at most this many poses: 7.2 hours.
pub const MAX_POSES: usize = 1 << 19;

const VERSION: u8 = 1;
/// Units of a position in a metre.
const UNITS_PER_M: f64 = 16_384.0;
/// Units of a heading in a radian.
const UNITS_PER_RAD: f64 = 65_536.0;
/// Coordinates beyond this are cut: 2^40 units are 67,000 km.
const MAX_UNITS: f64 = (1_u64 << 40) as f64;
/// Bytes of a variable-length integer, at most.
const MAX_VARINT: usize = 10;
/// How hard deflate tries, 0 to 10.
const EFFORT: u8 = 6;

/// Keeps the path of a run, up to [`MAX_POSES`].
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Recorder {
    /// The true pose every 0.05 s from 0 s on.
    pub path: Vec<Pose>,
}

impl Probe for Recorder {
    fn pose(&mut self, _time_s: f64, world_from_robot: Pose) {
        if self.path.len() < MAX_POSES {
            self.path.push(world_from_robot);
        }
    }
}

/// A text that is no trajectory. The caller reports the stored trajectory as unreadable and runs the job again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum TrajectoryError {
    /// It holds something else than pairs of hexadecimal digits.
    #[error("the trajectory is not hexadecimal text")]
    NotHexadecimal,
    /// It was written in a form that this version does not know.
    #[error("the trajectory's form {0} is unknown")]
    UnknownVersion(u8),
    /// It ends early, goes on too long, or cannot be inflated.
    #[error("the trajectory is damaged")]
    Damaged,
    /// It claims more poses than [`MAX_POSES`].
    #[error("the trajectory is too long")]
    TooLong,
}

/// The text of `path`; poses after [`MAX_POSES`] are dropped, a coordinate that is not finite becomes a bound or 0.
#[must_use]
pub fn encode(path: &[Pose]) -> String {
    let path = &path[..path.len().min(MAX_POSES)];
    let mut bytes = Vec::with_capacity(4 * path.len() + MAX_VARINT);
    put_varint(&mut bytes, path.len() as u64);
    put_column(&mut bytes, path.iter().map(|pose| to_units(pose.x_m, UNITS_PER_M)));
    put_column(&mut bytes, path.iter().map(|pose| to_units(pose.y_m, UNITS_PER_M)));
    put_column(&mut bytes, path.iter().map(|pose| to_units(pose.heading_rad, UNITS_PER_RAD)));
    let mut packed = vec![VERSION];
    packed.extend(compress_to_vec(&bytes, EFFORT));
    to_hex(&packed)
}

/// The poses of a trajectory's text, every 0.05 s from 0 s on.
///
/// # Errors
/// See [`TrajectoryError`]; no input makes it panic or take more than 64 MB.
pub fn decode(text: &str) -> Result<Vec<Pose>, TrajectoryError> {
    let packed = from_hex(text).ok_or(TrajectoryError::NotHexadecimal)?;
    let (version, deflated) = packed.split_first().ok_or(TrajectoryError::Damaged)?;
    if *version != VERSION {
        return Err(TrajectoryError::UnknownVersion(*version));
    }
    let limit = MAX_VARINT + 3 * MAX_VARINT * MAX_POSES;
    let bytes = decompress_to_vec_with_limit(deflated, limit).map_err(|_| TrajectoryError::Damaged)?;
    let mut rest = bytes.as_slice();
    let poses = take_poses(&mut rest)?;
    if rest.is_empty() { Ok(poses) } else { Err(TrajectoryError::Damaged) }
}

fn take_poses(rest: &mut &[u8]) -> Result<Vec<Pose>, TrajectoryError> {
    let count = take_varint(rest).ok_or(TrajectoryError::Damaged)?;
    let count = usize::try_from(count).ok().filter(|count| *count <= MAX_POSES).ok_or(TrajectoryError::TooLong)?;
    let mut column = |units| take_column(rest, count, units).ok_or(TrajectoryError::Damaged);
    let (xs, ys, headings) = (column(UNITS_PER_M)?, column(UNITS_PER_M)?, column(UNITS_PER_RAD)?);
    let poses = xs.into_iter().zip(ys).zip(headings);
    Ok(poses.map(|((x_m, y_m), heading_rad)| Pose { x_m, y_m, heading_rad }).collect())
}

/// The cast maps what is not a number to 0, and the clamp keeps second differences far from overflow.
fn to_units(value: f64, units: f64) -> i64 {
    (value * units).round().clamp(-MAX_UNITS, MAX_UNITS) as i64
}

fn put_column(bytes: &mut Vec<u8>, values: impl Iterator<Item = i64>) {
    let (mut last, mut step) = (0, 0);
    for value in values {
        let change = value - last - step;
        (last, step) = (value, value - last);
        put_varint(bytes, zigzag(change));
    }
}

/// Nothing if the bytes end early. Differences that overflow wrap around: the input was no trajectory then.
fn take_column(rest: &mut &[u8], count: usize, units: f64) -> Option<Vec<f64>> {
    if rest.len() < count {
        return None;
    }
    let (mut last, mut step) = (0_i64, 0_i64);
    let mut column = Vec::with_capacity(count);
    for _ in 0..count {
        step = step.wrapping_add(unzigzag(take_varint(rest)?));
        last = last.wrapping_add(step);
        column.push(last as f64 / units);
    }
    Some(column)
}

/// Small magnitudes of either sign become small numbers.
fn zigzag(value: i64) -> u64 {
    ((value << 1) ^ (value >> 63)) as u64
}

fn unzigzag(value: u64) -> i64 {
    (value >> 1) as i64 ^ -((value & 1) as i64)
}

fn put_varint(bytes: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        bytes.push(value as u8 | 0x80);
        value >>= 7;
    }
    bytes.push(value as u8);
}

fn take_varint(rest: &mut &[u8]) -> Option<u64> {
    let mut value = 0;
    for shift in (0..70).step_by(7) {
        let (byte, tail) = rest.split_first()?;
        *rest = tail;
        value |= u64::from(byte & 0x7f).checked_shl(shift)?;
        if byte & 0x80 == 0 {
            return Some(value);
        }
    }
    None
}

fn to_hex(bytes: &[u8]) -> String {
    let digit = |nibble: u8| char::from(b"0123456789abcdef"[usize::from(nibble)]);
    bytes.iter().flat_map(|byte| [digit(byte >> 4), digit(byte & 15)]).collect()
}

fn from_hex(text: &str) -> Option<Vec<u8>> {
    let digit = |byte: u8| char::from(byte).to_digit(16);
    let (pairs, rest) = text.as_bytes().as_chunks::<2>();
    if !rest.is_empty() {
        return None;
    }
    pairs.iter().map(|[high, low]| Some((digit(*high)? << 4 | digit(*low)?) as u8)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn drive(seconds: u32) -> Vec<Pose> {
        (0..seconds * 20)
            .map(|i| {
                let time_s = f64::from(i) * 0.05;
                let heading_rad = 0.3 * (0.7 * time_s).sin();
                Pose { x_m: 0.4 * time_s, y_m: 0.02 * (1.3 * time_s).cos(), heading_rad }
            })
            .collect()
    }

    #[test]
    fn a_path_comes_back_within_the_resolution() {
        let path = drive(60);
        let decoded = decode(&encode(&path)).unwrap();
        assert_eq!(decoded.len(), path.len());
        for (recorded, decoded) in path.iter().zip(&decoded) {
            assert!((recorded.x_m - decoded.x_m).abs() < 5e-5);
            assert!((recorded.y_m - decoded.y_m).abs() < 5e-5);
            assert!((recorded.heading_rad - decoded.heading_rad).abs() < 1e-5);
        }
    }

    #[test]
    fn a_minute_of_driving_takes_a_few_kilobytes() {
        assert!(encode(&drive(60)).len() < 10_000);
    }

    #[test]
    fn coordinates_that_are_not_finite_do_no_harm() {
        let wild = Pose { x_m: f64::NAN, y_m: f64::INFINITY, heading_rad: f64::NEG_INFINITY };
        let decoded = decode(&encode(&[wild, Pose::default(), wild])).unwrap();
        assert_eq!((decoded[0].x_m, decoded[1]), (0.0, Pose::default()));
        assert!(decoded[0].y_m > 6e7 && decoded[2].heading_rad < -1e7);
    }

    #[test]
    fn texts_that_are_no_trajectory_are_refused_by_their_fault() {
        assert_eq!(decode(""), Err(TrajectoryError::Damaged));
        assert_eq!(decode("abc"), Err(TrajectoryError::NotHexadecimal));
        assert_eq!(decode("zz"), Err(TrajectoryError::NotHexadecimal));
        assert_eq!(decode("09"), Err(TrajectoryError::UnknownVersion(9)));
        let good = encode(&drive(1));
        assert_eq!(decode(&good[..good.len() - 10]), Err(TrajectoryError::Damaged));
    }

    #[test]
    fn a_short_text_cannot_claim_a_long_trajectory() {
        let mut bytes = Vec::new();
        put_varint(&mut bytes, u64::MAX);
        let mut packed = vec![VERSION];
        packed.extend(compress_to_vec(&bytes, EFFORT));
        assert_eq!(decode(&to_hex(&packed)), Err(TrajectoryError::TooLong));
    }

    proptest! {
        #[test]
        fn any_path_comes_back(coordinates in proptest::collection::vec((-1e4..1e4, -1e4..1e4, -1e2..1e2), 0..100)) {
            let path: Vec<Pose> =
                coordinates.iter().map(|&(x_m, y_m, heading_rad)| Pose { x_m, y_m, heading_rad }).collect();
            let decoded = decode(&encode(&path)).unwrap();
            prop_assert_eq!(decoded.len(), path.len());
            for (recorded, decoded) in path.iter().zip(&decoded) {
                prop_assert!((recorded.x_m - decoded.x_m).abs() <= 5e-5);
                prop_assert!((recorded.y_m - decoded.y_m).abs() <= 5e-5);
                prop_assert!((recorded.heading_rad - decoded.heading_rad).abs() <= 1e-5);
            }
        }

        #[test]
        fn any_text_is_decoded_or_refused(bytes in proptest::collection::vec(any::<u8>(), 0..300), text in ".{0,50}") {
            let _ = decode(&text);
            let _ = decode(&to_hex(&bytes));
            let mut packed = vec![VERSION];
            packed.extend(compress_to_vec(&bytes, EFFORT));
            let _ = decode(&to_hex(&packed));
        }
    }
}
