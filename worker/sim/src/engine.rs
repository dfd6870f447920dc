//! Which simulation code this is.

/// The engine's id: a hash of the simulation's sources, its dependencies' versions and the compiler's release.
///
/// Equal engines give equal bits for equal jobs, on every machine.
#[must_use]
pub fn id() -> [u8; 32] {
    blake3::Hash::from_hex(env!("FURROW_ENGINE_ID")).expect("the build script writes 64 hexadecimal digits").into()
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_engine_has_a_name() {
        assert_ne!(super::id(), [0; 32]);
    }
}
