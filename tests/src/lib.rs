//! End-to-end tests. They are in `tests/end_to_end`, one binary that drives the real `furrow` processes; this
//! library is empty.
