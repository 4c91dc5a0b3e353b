//! Compiles the C sources into a static library. It needs only a C compiler, `CC_target`, `CC` or `cc`,
//! and `AR_target`, `AR` or `ar`; these may include options. `CFLAGS_target` or `CFLAGS` are added, for
//! example to choose a processor.
use std::{env, path::PathBuf, process::Command};

const SOURCES: &[&str] = &[@rust_sources@];

fn words(name: &str, otherwise: &str) -> Vec<String> {
    let target = env::var("TARGET").unwrap_or_default().replace('-', "_");
    let of_target = format!("{name}_{target}");
    println!("cargo:rerun-if-env-changed={of_target}");
    println!("cargo:rerun-if-env-changed={name}");
    env::var(of_target)
        .or_else(|_| env::var(name))
        .unwrap_or_else(|_| otherwise.into())
        .split_whitespace()
        .map(String::from)
        .collect()
}

fn tool(name: &str, otherwise: &str) -> Command {
    let named = words(name, otherwise);
    let mut command = Command::new(&named[0]);
    command.args(&named[1..]);
    command
}

fn run(command: &mut Command) {
    let done = command.status().unwrap_or_else(|error| panic!("{command:?}: {error}"));
    assert!(done.success(), "{command:?}: {done}");
}

fn main() {
    let out = PathBuf::from(env::var("OUT_DIR").expect("cargo sets OUT_DIR"));
    let mut objects = Vec::new();
    for source in SOURCES {
        let object = out.join(source).with_extension("o");
        run(tool("CC", "cc")
            .args(["-std=c99", "-O2", "-ffp-contract=off", "-fno-math-errno", "-fPIC"])
            .args(["-ffunction-sections", "-fdata-sections", "-Icsrc"])
            .args(words("CFLAGS", ""))
            .arg("-c")
            .arg(format!("csrc/{source}"))
            .arg("-o")
            .arg(&object));
        objects.push(object);
    }
    run(tool("AR", "ar")
        .arg("crs")
        .arg(out.join("libfluxobs_@prefix@.a"))
        .args(&objects));
    println!("cargo:rustc-link-search=native={}", out.display());
    println!("cargo:rustc-link-lib=static=fluxobs_@prefix@");
    println!("cargo:rerun-if-changed=csrc");
}
