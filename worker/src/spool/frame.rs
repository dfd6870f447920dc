//! Records as bytes: a mark, the length, a checksum, the content.
//!
//! The mark cannot occur in content that is UTF-8, so that the record behind a damaged one is found again; the
//! checksum covers length and content, so that nothing half-written passes for a record.

use std::ops::Range;

/// Begins every record.
const MARK: [u8; 4] = *b"\xF7run";
/// Mark, length, checksum \[bytes\].
const HEAD: usize = MARK.len() + size_of::<u64>() + blake3::OUT_LEN;

/// Writes `content` as a record to the end of `bytes`.
pub(super) fn append(bytes: &mut Vec<u8>, content: &[u8]) {
    let length = (content.len() as u64).to_le_bytes();
    bytes.extend_from_slice(&MARK);
    bytes.extend_from_slice(&length);
    bytes.extend_from_slice(checksum(length, content).as_bytes());
    bytes.extend_from_slice(content);
}

/// The content of a record that takes up all of `record`, if it is one.
pub(super) fn content(record: &[u8]) -> Option<&[u8]> {
    content_at(record, 0).filter(|content| content.end == record.len()).map(|content| &record[content])
}

/// What a file holds.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct Scanned {
    /// Every whole record, head and content, in order.
    pub(super) records: Vec<Range<usize>>,
    /// What lies between records and is none.
    pub(super) damaged: Vec<Range<usize>>,
    /// The end of the last whole record: what follows was not written to its end.
    pub(super) end: usize,
}

/// Finds the records in `bytes`, whatever these are.
pub(super) fn scan(bytes: &[u8]) -> Scanned {
    let mut scanned = Scanned::default();
    while let Some((begin, content)) = (scanned.end..bytes.len()).find_map(|at| Some((at, content_at(bytes, at)?))) {
        if begin > scanned.end {
            scanned.damaged.push(scanned.end..begin);
        }
        scanned.end = content.end;
        scanned.records.push(begin..content.end);
    }
    scanned
}

/// Where the content of the record lies that begins at `at`, if one does.
fn content_at(bytes: &[u8], at: usize) -> Option<Range<usize>> {
    let rest = bytes.get(at..)?.strip_prefix(&MARK)?;
    let (length, rest) = rest.split_first_chunk::<8>()?;
    let (expected, rest) = rest.split_first_chunk::<{ blake3::OUT_LEN }>()?;
    let content = rest.get(..usize::try_from(u64::from_le_bytes(*length)).ok()?)?;
    let whole = checksum(*length, content) == blake3::Hash::from_bytes(*expected);
    let begin = at + HEAD;
    whole.then_some(begin..begin + content.len())
}

fn checksum(length: [u8; 8], content: &[u8]) -> blake3::Hash {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&length).update(content);
    hasher.finalize()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn file(contents: &[&str]) -> Vec<u8> {
        let mut bytes = Vec::new();
        contents.iter().for_each(|content| append(&mut bytes, content.as_bytes()));
        bytes
    }

    fn contents(bytes: &[u8]) -> Vec<String> {
        let text =
            |record: &Range<usize>| String::from_utf8(content(&bytes[record.clone()]).unwrap().to_vec()).unwrap();
        scan(bytes).records.iter().map(text).collect()
    }

    #[test]
    fn records_are_read_back_in_order() {
        let bytes = file(&["one", "", "three"]);
        assert_eq!(contents(&bytes), ["one", "", "three"]);
        assert_eq!((scan(&bytes).damaged, scan(&bytes).end), (vec![], bytes.len()));
        assert_eq!(scan(&[]), Scanned::default());
    }

    #[test]
    fn wherever_the_last_record_is_torn_the_others_are_read_back() {
        let whole = file(&["one", "two"]);
        let all = file(&["one", "two", "the last one"]);
        for length in whole.len()..all.len() {
            assert_eq!(contents(&all[..length]), ["one", "two"], "torn at {length}");
            assert_eq!((scan(&all[..length]).end, scan(&all[..length]).damaged), (whole.len(), vec![]));
        }
    }

    #[test]
    fn damage_in_the_middle_costs_one_record() {
        let (first, second) = (file(&["one"]).len(), file(&["one", "two"]).len());
        for at in first..second {
            let mut bytes = file(&["one", "two", "three"]);
            bytes[at] ^= 0x40;
            assert_eq!(contents(&bytes), ["one", "three"], "damaged at {at}");
            assert_eq!(scan(&bytes).damaged.first(), Some(&(first..second)));
        }
    }

    #[test]
    fn a_length_beyond_all_bounds_is_damage() {
        let mut bytes = file(&["one"]);
        bytes[MARK.len()..MARK.len() + 8].fill(0xff);
        assert_eq!(scan(&bytes), Scanned::default());
    }

    proptest! {
        #[test]
        fn any_bytes_are_scanned_without_a_panic_and_cover_the_file(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            let scanned = scan(&bytes);
            prop_assert!(scanned.end <= bytes.len());
        }
    }
}
