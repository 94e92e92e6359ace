//! Modules of this crate depend on each other one way: no circle, so that each can be read, tested and changed with no
//! more than what it stands on.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

/// Top-level modules, each with those that its paths name.
type Graph = BTreeMap<String, BTreeSet<String>>;

/// The top-level modules that the paths from the crate's root in `text` begin with; comments and unit tests do not
/// count.
fn named_in(text: &str) -> BTreeSet<String> {
    let text = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
    let code: String = text.lines().filter(|line| !line.trim_start().starts_with("//")).collect();
    let starts = code.match_indices("crate::").map(|(at, path)| &code[at + path.len()..]);
    starts.flat_map(first_names).collect()
}

/// `a` of `a::b`, `a` and `c` of `{a::{b, d}, c}`.
fn first_names(path: &str) -> Vec<String> {
    let word = |text: &str| text.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect::<String>();
    let Some(list) = path.strip_prefix('{') else { return vec![word(path)] };
    let (mut depth, mut names) = (0i32, vec![String::new()]);
    for c in list.chars() {
        match c {
            '{' => depth += 1,
            '}' if depth == 0 => break,
            '}' => depth -= 1,
            ',' if depth == 0 => {
                names.push(String::new());
                continue;
            }
            _ => {}
        }
        names.last_mut().into_iter().for_each(|name| name.push(c));
    }
    names.iter().map(|name| word(name.trim_start())).filter(|name| !name.is_empty()).collect()
}

/// Adds what the files of a folder name to `module`, or, in the crate's own folder, each to the module it is of.
fn read(folder: &Path, module: Option<&str>, graph: &mut Graph) {
    for entry in fs::read_dir(folder).expect("sources") {
        let path = entry.expect("an entry").path();
        let stem = path.file_stem().and_then(|s| s.to_str()).expect("a plain name").to_owned();
        if ["lib", "tests", "module_graph"].contains(&stem.as_str()) {
            continue;
        }
        let module = module.unwrap_or(&stem);
        if path.is_dir() {
            read(&path, Some(module), graph);
        } else if path.extension().is_some_and(|e| e == "rs") {
            let names = named_in(&fs::read_to_string(&path).expect("text"));
            graph.entry(module.to_owned()).or_default().extend(names.into_iter().filter(|name| name != module));
        }
    }
}

/// Modules each of which names the next, and the last the first.
fn circle(graph: &Graph) -> Option<Vec<String>> {
    fn from(module: &str, graph: &Graph, way: &mut Vec<String>, done: &mut BTreeSet<String>) -> Option<Vec<String>> {
        if let Some(start) = way.iter().position(|m| m == module) {
            return Some(way[start..].to_vec());
        }
        if !done.insert(module.to_owned()) {
            return None;
        }
        way.push(module.to_owned());
        let found = graph.get(module)?.iter().find_map(|next| from(next, graph, way, done));
        way.pop();
        found
    }
    let mut done = BTreeSet::new();
    graph.keys().find_map(|module| from(module, graph, &mut Vec::new(), &mut done))
}

#[test]
fn no_modules_depend_on_each_other_in_a_circle() {
    let mut graph = Graph::new();
    read(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"), None, &mut graph);
    assert!(graph.len() > 20, "{graph:?}");
    for (module, named) in &graph {
        let unknown: Vec<&String> = named.iter().filter(|name| !graph.contains_key(*name)).collect();
        assert!(unknown.is_empty(), "{module} names {unknown:?} by way of the crate's root, not of their modules");
    }
    if let Some(circle) = circle(&graph) {
        panic!("modules that depend on each other: {} -> {}", circle.join(" -> "), circle[0]);
    }
}

#[test]
fn circles_are_found_wherever_paths_stand() {
    let graph = |files: &[(&str, &str)]| -> Graph {
        files.iter().map(|(module, text)| ((*module).to_owned(), named_in(text))).collect()
    };
    let b = "use crate::{\n    c::{X, Y},\n    d,\n};\n// crate::a::Z\n#[cfg(test)]\nmod tests {\n    use crate::a::Z;\n}\n";
    let files = [("a", "use crate::b::X;\n"), ("b", b), ("c", ""), ("d", "")];
    assert_eq!(named_in(b), BTreeSet::from(["c".to_owned(), "d".to_owned()]));
    assert_eq!(circle(&graph(&files)), None);
    let closed = [&files[..3], &[("d", "fn f() -> crate::a::Z {}\n")]].concat();
    assert_eq!(circle(&graph(&closed)), Some(vec!["a".to_owned(), "b".to_owned(), "d".to_owned()]));
}
