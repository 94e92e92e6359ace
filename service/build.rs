//! Builds the page under the feature `viewer` and hands its files to `src/viewer.rs`.
//!
//! Never fails: without Node, or where the page cannot be built, the service says on its page how to get it. Without
//! the feature nothing is run and nothing is fetched.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs};

/// What the page is built from, seen from `viewer/`; beside it the client, which it uses from its sources.
const INPUTS: [&str; 7] =
    ["src", "index.html", "package.json", "package-lock.json", "vite.config.ts", "tsconfig.json", "../clients/js/src"];

/// What the page's build writes.
const FILES: [(&str, &str); 4] = [
    ("index.html", "text/html; charset=utf-8"),
    ("viewer.js", "text/javascript; charset=utf-8"),
    ("worker.js", "text/javascript; charset=utf-8"),
    ("viewer.css", "text/css; charset=utf-8"),
];

fn main() {
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    let source =
        Path::new(&env::var_os("CARGO_MANIFEST_DIR").expect("cargo sets CARGO_MANIFEST_DIR")).join("../viewer");
    println!("cargo::rerun-if-changed=build.rs");
    let built = if env::var_os("CARGO_FEATURE_VIEWER").is_some() {
        for part in INPUTS {
            println!("cargo::rerun-if-changed={}", source.join(part).display());
        }
        build(&source, &out.join("viewer"))
    } else {
        Err("this build was made without it".to_owned())
    };
    let (files, missing) = match &built {
        Ok(dir) => (FILES.map(|(name, kind)| file(dir, name, kind)).concat(), String::new()),
        Err(why) => (String::new(), why.clone()),
    };
    if let (Err(why), true) = (&built, env::var_os("CARGO_FEATURE_VIEWER").is_some()) {
        println!("cargo::warning=the page is not part of this build: {why}");
    }
    let code =
        format!("pub(super) const MISSING: &str = {missing:?};\npub(super) const FILES: &[File] = &[{files}];\n");
    fs::write(out.join("viewer_files.rs"), code).expect("OUT_DIR can be written");
}

fn file(dir: &Path, name: &str, kind: &str) -> String {
    let path = dir.join(name);
    format!("File {{ name: {name:?}, kind: {kind:?}, bytes: include_bytes!({path:?}) }},\n")
}

/// Installs what the page's lock file names, and builds it.
fn build(source: &Path, out: &Path) -> Result<PathBuf, String> {
    let lock = source.join("package-lock.json");
    // npm notes there what it has installed: where that is as new as the lock file, there is nothing to fetch.
    let installed = source.join("node_modules/.package-lock.json");
    let modified = |path: &Path| fs::metadata(path).and_then(|m| m.modified()).ok();
    if modified(&installed).is_none() || modified(&installed) < modified(&lock) {
        run(source, "npm", &["ci", "--no-audit", "--no-fund", "--prefer-offline", "--fetch-retries=1"])?;
    }
    let out_text = out.to_str().ok_or("the build directory's name is not UTF-8")?;
    run(source, "npm", &["run", "build", "--", "--outDir", out_text, "--emptyOutDir"])?;
    match FILES.iter().find(|(name, _)| !out.join(name).is_file()) {
        Some((name, _)) => Err(format!("its build wrote no {name}")),
        None => Ok(out.to_owned()),
    }
}

fn run(dir: &Path, program: &str, arguments: &[&str]) -> Result<(), String> {
    let command = format!("{program} {}", arguments.join(" "));
    let done = Command::new(program).args(arguments).current_dir(dir).output();
    let done = done.map_err(|error| format!("`{command}` cannot be run ({error}): install Node 20.19 or newer"))?;
    if done.status.success() {
        return Ok(());
    }
    let said = String::from_utf8_lossy(&done.stderr);
    let last = said.lines().rev().find(|line| !line.trim().is_empty()).unwrap_or_default().to_owned();
    Err(format!("`{command}` failed: {last}"))
}
