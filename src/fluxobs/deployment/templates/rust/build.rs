//! Compiles the C sources into a static library, with nothing but a C compiler: `CC_target`, `CC` or
//! `cc`, likewise `AR` and `ar`. `CFLAGS` are added, such as those that choose a processor.
use std::{env, path::PathBuf, process::Command};

const SOURCES: &[&str] = &[@rust_sources@];

fn tool(name: &str, otherwise: &str) -> String {
    let target = env::var("TARGET").unwrap_or_default().replace('-', "_");
    env::var(format!("{name}_{target}"))
        .or_else(|_| env::var(name))
        .unwrap_or_else(|_| otherwise.into())
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
        run(Command::new(tool("CC", "cc"))
            .args(["-std=c99", "-O2", "-ffp-contract=off", "-fno-math-errno", "-fPIC"])
            .args(["-ffunction-sections", "-fdata-sections", "-Icsrc"])
            .args(env::var("CFLAGS").unwrap_or_default().split_whitespace())
            .arg("-c")
            .arg(format!("csrc/{source}"))
            .arg("-o")
            .arg(&object));
        objects.push(object);
    }
    run(Command::new(tool("AR", "ar"))
        .arg("crs")
        .arg(out.join("libfluxobs_@prefix@.a"))
        .args(&objects));
    println!("cargo:rustc-link-search=native={}", out.display());
    println!("cargo:rustc-link-lib=static=fluxobs_@prefix@");
    println!("cargo:rerun-if-changed=csrc");
}
