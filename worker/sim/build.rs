//! Names the engine, and lists the plan files.
//!
//! The engine's id is a hash of everything that can change a result's bits: the non-test sources of the
//! simulation, the locked versions of its dependencies, and the compiler's release.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs};

/// Files that hold nothing but tests.
const TEST_FILES: [&str; 11] = [
    "bench_scans.rs",
    "canopy/tests.rs",
    "chain/tests.rs",
    "cloud/oracle.rs",
    "conformance.rs",
    "fx10/tests.rs",
    "golden.rs",
    "lane/simulated.rs",
    "lane_view.rs",
    "lanes/tests.rs",
    "table5.rs",
];

fn main() {
    let here = PathBuf::from(env::var("CARGO_MANIFEST_DIR").expect("cargo sets it"));
    let navigation = here.join("../navigation");
    let lock = here.join("../../Cargo.lock");
    let mut hasher = blake3::Hasher::new();
    for package in [&navigation, &here] {
        hash_sources(&package.join("src"), &mut hasher);
        println!("cargo::rerun-if-changed={}", package.join("Cargo.toml").display());
    }
    hash_dependencies(&lock, &[&navigation, &here], &mut hasher);
    hasher.update(compiler_release().as_bytes());
    println!("cargo::rerun-if-changed={}", lock.display());
    println!("cargo::rustc-env=FURROW_ENGINE_ID={}", hasher.finalize().to_hex());
    list_plans(&here.join("plans"));
}

/// Hashes names and texts of all source files, sorted by name, without their tests.
fn hash_sources(folder: &Path, hasher: &mut blake3::Hasher) {
    println!("cargo::rerun-if-changed={}", folder.display());
    for path in files(folder, "rs") {
        let name = path.strip_prefix(folder).expect("it lies in the folder").display().to_string();
        if TEST_FILES.iter().any(|file| name.ends_with(file)) {
            continue;
        }
        let text = fs::read_to_string(&path).expect("a source file can be read").replace('\r', "");
        // A file's own tests stand at its end.
        let code = text.split("\n#[cfg(test)]\nmod tests {").next().unwrap_or_default();
        let code = code.split("\n#[cfg(test)]\npub(crate) mod tests {").next().unwrap_or_default();
        hasher.update(name.replace('\\', "/").as_bytes()).update(&[0]).update(code.as_bytes()).update(&[0]);
    }
}

fn files(folder: &Path, extension: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).expect("the folder can be read") {
        let path = entry.expect("the folder can be read").path();
        if path.is_dir() {
            found.extend(files(&path, extension));
        } else if path.extension().is_some_and(|e| e == extension) {
            found.push(path);
        }
    }
    found.sort();
    found
}

/// Hashes name and version of every package that the two crates need to run, as locked.
fn hash_dependencies(lock: &Path, packages: &[&PathBuf], hasher: &mut blake3::Hasher) {
    let lock: toml::Table = fs::read_to_string(lock).expect("Cargo.lock is there").parse().expect("it is TOML");
    let locked = lock["package"].as_array().expect("it lists packages");
    let mut wanted: Vec<String> = packages.iter().flat_map(|package| direct_dependencies(package, locked)).collect();
    let mut seen = BTreeSet::new();
    while let Some(name) = wanted.pop() {
        for package in locked.iter().filter(|package| is_named(package, &name)) {
            if seen.insert(format!("{} {}", text(package, "name"), text(package, "version"))) {
                wanted.extend(dependencies(package));
            }
        }
    }
    for package in seen.iter().filter(|package| !package.starts_with("furrow-")) {
        hasher.update(package.as_bytes()).update(&[0]);
    }
}

/// The locked names of what the package's `[dependencies]` section asks for; tests and benchmarks do not count.
fn direct_dependencies(package: &Path, locked: &[toml::Value]) -> Vec<String> {
    let manifest: toml::Table =
        fs::read_to_string(package.join("Cargo.toml")).expect("a manifest").parse().expect("it is TOML");
    let name = manifest["package"]["name"].as_str().expect("a package has a name");
    let asked: Vec<&String> = manifest["dependencies"].as_table().expect("a table").keys().collect();
    let entry = locked.iter().find(|entry| text(entry, "name") == name).expect("the package is locked");
    let is_asked = |locked: &String| asked.iter().any(|name| locked.split(' ').next() == Some(name));
    dependencies(entry).into_iter().filter(is_asked).collect()
}

fn dependencies(package: &toml::Value) -> Vec<String> {
    let list = package.get("dependencies").and_then(toml::Value::as_array);
    list.into_iter().flatten().filter_map(|name| name.as_str().map(str::to_owned)).collect()
}

/// Whether `name` ("name" or "name version") means this package.
fn is_named(package: &toml::Value, name: &str) -> bool {
    let mut words = name.split(' ');
    words.next() == Some(text(package, "name")) && words.next().is_none_or(|v| v == text(package, "version"))
}

fn text<'a>(package: &'a toml::Value, key: &str) -> &'a str {
    package.get(key).and_then(toml::Value::as_str).unwrap_or_default()
}

/// The compiler's release, without the machine it was built for.
fn compiler_release() -> String {
    let rustc = env::var("RUSTC").expect("cargo sets it");
    let output = Command::new(rustc).arg("-vV").output().expect("the compiler runs");
    let text = String::from_utf8_lossy(&output.stdout);
    text.lines().find(|line| line.starts_with("release: ")).expect("it says its release").to_owned()
}

/// Writes the list of plan files as Rust, so that a new plan is one new file.
fn list_plans(folder: &Path) {
    println!("cargo::rerun-if-changed={}", folder.display());
    let mut code = String::from("&[\n");
    let name = |path: &Path| {
        let name = path.strip_prefix(folder).expect("it lies in the folder").with_extension("");
        name.display().to_string().replace('\\', "/")
    };
    let mut plans: Vec<_> = files(folder, "json").into_iter().map(|path| (name(&path), path)).collect();
    plans.sort();
    for (name, path) in plans {
        writeln!(code, "    ({name:?}, include_str!({:?})),", path.display().to_string()).expect("a text takes all");
    }
    code.push_str("]\n");
    let out = PathBuf::from(env::var("OUT_DIR").expect("cargo sets it")).join("plans.rs");
    fs::write(out, code).expect("the build folder can be written");
}
