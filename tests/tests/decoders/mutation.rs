//! A valid message, spoiled: keys removed, doubled or swapped, values replaced, bytes flipped, cut and repeated.

use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::Index;
use serde_json::{Map, Value, json};

/// Cases of a claim, unless `PROPTEST_CASES` says otherwise.
const CASES: u32 = 400;

/// How claims of this crate are tried.
pub(crate) fn config() -> ProptestConfig {
    let usual = ProptestConfig { failure_persistence: None, ..ProptestConfig::default() };
    if std::env::var_os("PROPTEST_CASES").is_some() { usual } else { ProptestConfig { cases: CASES, ..usual } }
}

/// A change to the structure of a message.
#[derive(Debug, Clone)]
enum Change {
    /// Takes a key or item away.
    Remove,
    /// Puts something else there.
    Replace(Value),
    /// Puts it into lists or objects of its own, so deep.
    Wrap(u8, bool),
    /// Adds a key or item.
    Add(String, Value),
}

/// A change to the bytes of a message.
#[derive(Debug, Clone)]
enum Damage {
    Flip(Index, u8),
    Cut(Index),
    Repeat(Index, Index),
    Insert(Index, Vec<u8>),
}

/// `message` after some changes, as bytes; often still JSON, sometimes still right.
pub(crate) fn spoiled(message: Value) -> impl Strategy<Value = Vec<u8>> {
    let changes = vec((any::<Index>(), change()), 0..4);
    let damages = prop_oneof![3 => Just(Vec::new()), 1 => vec(damage(), 1..4)];
    (changes, damages).prop_map(move |(changes, damages)| {
        let mut message = message.clone();
        for (place, change) in changes {
            let n = place.index(nodes(&message));
            apply(&mut message, n, &change);
        }
        let mut bytes = message.to_string().into_bytes();
        damages.iter().for_each(|damage| damage.strike(&mut bytes));
        bytes
    })
}

fn change() -> impl Strategy<Value = Change> {
    prop_oneof![
        Just(Change::Remove),
        junk().prop_map(Change::Replace),
        (1..140_u8, any::<bool>()).prop_map(|(depth, list)| Change::Wrap(depth, list)),
        (".{0,12}", junk()).prop_map(|(key, value)| Change::Add(key, value)),
    ]
}

/// Values at the edges of what a reader may expect.
pub(crate) fn junk() -> impl Strategy<Value = Value> {
    let edges = [
        json!(null),
        json!(true),
        json!(0),
        json!(-1),
        json!(1),
        json!(2.5),
        json!(-0.0),
        json!(i32::MAX),
        json!(u32::MAX),
        json!(i64::MAX),
        json!(i64::MIN),
        json!(u64::MAX),
        json!(9_007_199_254_740_993_u64),
        json!(1e308),
        json!(5e-324),
        json!(""),
        json!(" "),
        json!("\u{0}"),
        json!("é\u{202e}"),
        json!("../../etc"),
        json!("x".repeat(70_000)),
        json!([]),
        json!({}),
        json!([[]]),
        json!({"kind": "rgop"}),
        json!({"kind": null}),
        json!({"fixed": -1}),
        json!([[0, 1e308]]),
    ];
    prop_oneof![
        4 => proptest::sample::select(edges.to_vec()),
        1 => any::<i64>().prop_filter("a sweep as large as is allowed takes long", |n| !(50..5_000_000).contains(n))
            .prop_map(Value::from),
        1 => any::<f64>().prop_map(Value::from),
        1 => ".{0,20}".prop_map(Value::from),
    ]
}

fn damage() -> impl Strategy<Value = Damage> {
    let deep = prop_oneof![Just(b"[".repeat(50_000)), Just(b"{\"a\":".repeat(50_000)), Just(b"1e999".to_vec())];
    let inserted = prop_oneof![vec(any::<u8>(), 1..20), deep, Just(b"9".repeat(5_000))];
    prop_oneof![
        (any::<Index>(), any::<u8>()).prop_map(|(at, bits)| Damage::Flip(at, bits)),
        any::<Index>().prop_map(Damage::Cut),
        (any::<Index>(), any::<Index>()).prop_map(|(from, to)| Damage::Repeat(from, to)),
        (any::<Index>(), inserted).prop_map(|(at, bytes)| Damage::Insert(at, bytes)),
    ]
}

impl Damage {
    fn strike(&self, bytes: &mut Vec<u8>) {
        if bytes.is_empty() {
            return;
        }
        match self {
            Self::Flip(at, bits) => {
                let at = at.index(bytes.len());
                bytes[at] ^= bits;
            }
            Self::Cut(at) => bytes.truncate(at.index(bytes.len())),
            Self::Repeat(from, to) => {
                let (from, to) = (from.index(bytes.len()), to.index(bytes.len()));
                let part = bytes[from.min(to)..from.max(to)].to_vec();
                bytes.splice(to..to, part);
            }
            Self::Insert(at, new) => {
                let at = at.index(bytes.len());
                bytes.splice(at..at, new.iter().copied());
            }
        }
    }
}

/// How many values there are in `value`, itself and all keys' and items'.
fn nodes(value: &Value) -> usize {
    1 + match value {
        Value::Array(items) => items.iter().map(nodes).sum(),
        Value::Object(object) => object.values().map(nodes).sum(),
        _ => 0,
    }
}

/// Applies `change` to the `n`th value of `value`, counted from itself as 0.
fn apply(value: &mut Value, n: usize, change: &Change) {
    if n == 0 {
        return apply_here(value, change);
    }
    let mut left = n - 1;
    let mut gone = None;
    let children: Vec<(Value, &mut Value)> = match value {
        Value::Array(items) => items.iter_mut().enumerate().map(|(i, item)| (json!(i), item)).collect(),
        Value::Object(object) => object.iter_mut().map(|(key, item)| (json!(key), item)).collect(),
        _ => Vec::new(),
    };
    for (key, child) in children {
        let size = nodes(child);
        if left < size {
            if left == 0 && matches!(change, Change::Remove) {
                gone = Some(key)
            } else {
                apply(child, left, change)
            }
            break;
        }
        left -= size;
    }
    match (value, gone) {
        (Value::Array(items), Some(Value::Number(i))) => drop(items.remove(i.as_u64().unwrap() as usize)),
        (Value::Object(object), Some(Value::String(key))) => drop(object.remove(&key)),
        _ => {}
    }
}

fn apply_here(value: &mut Value, change: &Change) {
    match change {
        Change::Remove => *value = Value::Null,
        Change::Replace(junk) => *value = junk.clone(),
        Change::Wrap(depth, list) => {
            for _ in 0..*depth {
                let inner = value.take();
                *value =
                    if *list { json!([inner]) } else { Value::Object(Map::from_iter([("kind".to_owned(), inner)])) };
            }
        }
        Change::Add(key, junk) => match value {
            Value::Array(items) => items.push(junk.clone()),
            Value::Object(object) => drop(object.insert(key.clone(), junk.clone())),
            other => *other = json!([other.take(), junk]),
        },
    }
}
