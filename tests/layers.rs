//! The order of the layers that `lib.rs` states, held against every `use` of the library; no circle
//! between files; and the limits on the length of files and functions and on arguments.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// A module's path below `src`, such as `["plan", "decide"]`; `lib.rs` is empty.
type Module = Vec<String>;

const MAX_FILE_LINES: usize = 500;
const MAX_ARGUMENTS: usize = 5;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn rust_files(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap().map(Result::unwrap) {
        let path = entry.path();
        if path.is_dir() {
            rust_files(&path, files);
        } else if path.extension().is_some_and(|e| e == "rs") {
            files.push(path);
        }
    }
}

/// The library's modules with their code: no comments, no tests.
fn modules() -> BTreeMap<Module, String> {
    let source = root().join("src");
    let mut files = Vec::new();
    rust_files(&source, &mut files);
    let mut modules = BTreeMap::new();
    for path in files {
        let relative = path.strip_prefix(&source).unwrap().with_extension("");
        let mut module: Module =
            relative.iter().map(|part| part.to_str().unwrap().to_owned()).collect();
        if module == ["main"] || module.last().unwrap() == "tests" {
            continue; // the program, which uses the library from outside; tests
        }
        if ["mod", "lib"].contains(&module.last().unwrap().as_str()) {
            module.pop();
        }
        let text = std::fs::read_to_string(&path).unwrap();
        let code = text.split("#[cfg(test)]\nmod tests").next().unwrap();
        let lines = code.lines().map(|line| line.split("//").next().unwrap());
        modules.insert(module, lines.collect::<Vec<_>>().join("\n"));
    }
    modules
}

/// Every path in the code that starts with `crate` or `super`, braces expanded.
fn paths(code: &str) -> Vec<Vec<String>> {
    let mut found = Vec::new();
    for start in ["crate::", "super::"] {
        for (at, _) in code.match_indices(start) {
            let before = code[..at].chars().next_back();
            if before.is_some_and(|c| c.is_alphanumeric() || c == '_' || c == ':') {
                continue;
            }
            expand(&code[at..], &mut Vec::new(), &mut found);
        }
    }
    found
}

/// Reads `a::b::{c, d::e}` from the start of the code; the rest of the code.
fn expand<'a>(code: &'a str, prefix: &mut Vec<String>, found: &mut Vec<Vec<String>>) -> &'a str {
    let mut rest = code.trim_start();
    let depth = prefix.len();
    loop {
        if let Some(inner) = rest.strip_prefix('{') {
            let mut inner = inner.trim_start();
            while !inner.is_empty() && !inner.starts_with('}') {
                let after = expand(inner, prefix, found);
                let step = after.find([',', '}']).unwrap_or(after.len());
                inner = after[step..].trim_start_matches(',').trim_start();
            }
            rest = inner.strip_prefix('}').unwrap_or(inner);
            break;
        }
        let end = rest.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(rest.len());
        if end == 0 {
            break;
        }
        prefix.push(rest[..end].to_owned());
        rest = &rest[end..];
        match rest.strip_prefix("::") {
            Some(more) => rest = more,
            None => {
                found.push(prefix.clone());
                break;
            }
        }
    }
    prefix.truncate(depth);
    rest
}

/// Where modules re-export an item of a module below them from: `pub use child::Item`.
fn reexports(modules: &BTreeMap<Module, String>) -> BTreeMap<(Module, String), Module> {
    let mut found = BTreeMap::new();
    for (module, code) in modules {
        for (at, _) in code.match_indices("use ") {
            let mut items = Vec::new();
            expand(&code[at + 4..], &mut Vec::new(), &mut items);
            for path in items.iter().filter(|path| path.len() > 1) {
                let mut child = module.clone();
                child.extend(path[..path.len() - 1].iter().cloned());
                if modules.contains_key(&child) {
                    found.insert((module.clone(), path[path.len() - 1].clone()), child);
                }
            }
        }
    }
    found
}

/// The library as its files say.
struct Library {
    modules: BTreeMap<Module, String>,
    reexports: BTreeMap<(Module, String), Module>,
}

impl Library {
    fn read() -> Self {
        let modules = modules();
        let reexports = reexports(&modules);
        Self { modules, reexports }
    }

    /// The module that defines what a path of another module names.
    fn target(&self, path: &[String], from: &Module) -> Option<Module> {
        let mut absolute: Module = if path[0] == "crate" { Vec::new() } else { from.clone() };
        for part in path {
            match part.as_str() {
                "crate" => {}
                "super" => drop(absolute.pop()),
                name => absolute.push(name.to_owned()),
            }
        }
        let mut item = None;
        while !absolute.is_empty() && !self.modules.contains_key(&absolute) {
            item = absolute.pop();
        }
        while let Some(name) = &item
            && let Some(module) = self.reexports.get(&(absolute.clone(), name.clone()))
        {
            absolute = module.clone();
        }
        (!absolute.is_empty() && absolute != *from).then_some(absolute)
    }
}

/// Which modules each module uses.
fn uses() -> BTreeMap<Module, BTreeSet<Module>> {
    let library = Library::read();
    let of = |(module, code): (&Module, &String)| {
        let used = paths(code).iter().filter_map(|path| library.target(path, module)).collect();
        (module.clone(), used)
    };
    library.modules.iter().map(of).collect()
}

/// The layers as `lib.rs` lists them, the lowest first.
fn layers() -> Vec<Vec<String>> {
    let text = std::fs::read_to_string(root().join("src/lib.rs")).unwrap();
    let list = text.split("//! ```text\n").nth(1).unwrap().split("//! ```").next().unwrap();
    let words =
        |line: &str| line.trim_start_matches("//!").split_whitespace().map(str::to_owned).collect();
    list.lines().map(words).collect()
}

#[test]
fn a_module_uses_only_layers_below_its_own() {
    let layers = layers();
    let layer = |name: &str| {
        layers
            .iter()
            .position(|names| names.iter().any(|n| n == name))
            .unwrap_or_else(|| panic!("lib.rs names no layer of {name}"))
    };
    let uses = uses();
    let mut count = 0;
    for (module, used) in uses.iter().filter(|(module, _)| !module.is_empty()) {
        for other in used.iter().filter(|other| other[0] != module[0]) {
            count += 1;
            assert!(
                layer(&other[0]) < layer(&module[0]),
                "{} uses {}, which is no layer below",
                module.join("::"),
                other.join("::")
            );
        }
    }
    assert!(count > 200, "the uses were read: {count}");
    let named: BTreeSet<&String> = layers.iter().flatten().collect();
    assert_eq!(named.len(), layers.iter().flatten().count(), "no module is in two layers");
    let there: BTreeSet<&String> = uses.keys().filter_map(|module| module.first()).collect();
    assert_eq!(named, there);
}

/// A file may use what the `mod.rs` above it defines: that is no circle.
#[test]
fn no_circle_between_files() {
    let mut left = uses();
    left.remove(&Module::new());
    for (module, used) in &mut left {
        used.retain(|other| !module.starts_with(other));
    }
    // What uses nothing that is left, and what nothing uses, is in no circle.
    loop {
        let used: BTreeSet<Module> = left.values().flatten().cloned().collect();
        let is_free = |module: &Module, uses: &BTreeSet<Module>| {
            !used.contains(module) || uses.iter().all(|other| !left.contains_key(other))
        };
        let free: Vec<Module> =
            left.iter().filter(|(m, uses)| is_free(m, uses)).map(|(m, _)| m.clone()).collect();
        if free.is_empty() {
            break;
        }
        left.retain(|module, _| !free.contains(module));
        for uses in left.values_mut() {
            uses.retain(|other| !free.contains(other));
        }
    }
    let circle: Vec<String> = left.keys().map(|module| module.join("::")).collect();
    assert!(circle.is_empty(), "these files use each other in a circle: {circle:?}");
}

#[test]
fn paths_are_read_with_their_braces() {
    let code = "use crate::a::{b, c::{self, d}};\nfn f(x: super::e::F) {} mysuper::g crate::h::i()";
    let found: Vec<String> = paths(code).iter().map(|path| path.join("::")).collect();
    let expected =
        ["crate::a::b", "crate::a::c::self", "crate::a::c::d", "crate::h::i", "super::e::F"];
    assert_eq!(found, expected);
}

#[test]
fn no_file_is_longer_than_one_algorithm() {
    let mut files = Vec::new();
    for folder in ["src", "tests"] {
        rust_files(&root().join(folder), &mut files);
    }
    for path in files {
        let lines = std::fs::read_to_string(&path).unwrap().lines().count();
        assert!(lines <= MAX_FILE_LINES, "{}: {lines} lines", path.display());
    }
}

/// The names of the code's functions, and how many arguments each has besides `self`.
fn functions(code: &str) -> Vec<(String, usize)> {
    // An arrow's head closes nothing.
    let code = code.replace("->", "  ");
    let mut found = Vec::new();
    for (at, _) in code.match_indices("fn ") {
        let is_word = |c: char| c.is_alphanumeric() || c == '_';
        let name: String = code[at + 3..].chars().take_while(|c| is_word(*c)).collect();
        if name.is_empty() || code[..at].ends_with(is_word) {
            continue; // the type `fn (…)`, or the end of a word
        }
        let (mut depth, mut is_list) = (0, false);
        let (mut arguments, mut text) = (Vec::new(), String::new());
        let signature = &code[at + 3 + name.len()..];
        for c in signature.chars() {
            is_list |= depth == 0 && c == '(';
            depth += i32::from("([{<".contains(c)) - i32::from(")]}>".contains(c));
            match (depth, c) {
                (0, _) if is_list => break,
                (1, ',') if is_list => arguments.push(std::mem::take(&mut text)),
                _ if is_list => text.push(c),
                _ => {}
            }
        }
        arguments.push(text);
        let is_self =
            |a: &String| a.split([':', ' ', '&', '(']).any(|word| ["self", "slf"].contains(&word));
        let counts = |a: &&String| !a.trim_matches(['(', ' ', '\n']).is_empty() && !is_self(a);
        found.push((name, arguments.iter().filter(counts).count()));
    }
    found
}

#[test]
fn no_function_has_more_than_five_arguments() {
    let code = "fn a<T: Fn(u8) -> u8>(&self, x: (u8, u8), f: impl Fn(u8, u8) -> u8,) {} fn b() {}";
    assert_eq!(functions(code), [("a".to_owned(), 2), ("b".to_owned(), 0)]);
    let mut files = Vec::new();
    for folder in ["src", "tests"] {
        rust_files(&root().join(folder), &mut files);
    }
    let mut count = 0;
    for path in files {
        let text = std::fs::read_to_string(&path).unwrap();
        let lines = text.lines().map(|line| line.split("//").next().unwrap());
        for (name, arguments) in functions(&lines.collect::<Vec<_>>().join("\n")) {
            count += 1;
            assert!(arguments <= MAX_ARGUMENTS, "{}: {name}: {arguments}", path.display());
        }
    }
    assert!(count > 1500, "the functions were read: {count}");
}
