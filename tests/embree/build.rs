//! Links Embree 3 where its header is found; otherwise the benchmark says that it was skipped.

use std::path::Path;

fn main() {
    println!("cargo::rustc-check-cfg=cfg(embree)");
    println!("cargo::rerun-if-env-changed=EMBREE_PREFIX");
    let prefix = std::env::var("EMBREE_PREFIX").unwrap_or_else(|_| "/usr".to_owned());
    if Path::new(&prefix).join("include/embree3/rtcore.h").exists() {
        println!("cargo::rustc-cfg=embree");
        println!("cargo::rustc-link-search=native={prefix}/lib");
        println!("cargo::rustc-link-lib=dylib=embree3");
    }
}
