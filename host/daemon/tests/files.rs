//! The files of a crate, by what they use of each other: none leads back to itself.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
};

use crate::documentation::root;

/// A module by the names that lead to it from the root of its crate.
type Module = Vec<String>;

/// The files below a folder, in the folders named `src`.
fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap().flatten() {
        let (path, name) = (entry.path(), entry.file_name());
        let name = name.to_string_lossy();
        if path.is_dir() && !name.starts_with('.') && name != "target" {
            sources(&path, found);
        } else if name.ends_with(".rs") && path.components().any(|part| part.as_os_str() == "src") {
            found.push(path);
        }
    }
}

/// The folder of a crate's sources, and the module that a file is.
fn module(file: &Path) -> (PathBuf, Module) {
    let source = file.ancestors().find(|folder| folder.ends_with("src"));
    let source = source.unwrap().to_owned();
    let inside = file.strip_prefix(&source).unwrap().with_extension("");
    let mut names: Module = inside
        .iter()
        .map(|name| name.to_string_lossy().into_owned())
        .collect();
    if matches!(
        names.last().map(String::as_str),
        Some("lib" | "main" | "mod")
    ) {
        names.pop();
    }
    (source, names)
}

/// The paths that a tree of `use` names.
fn paths(tree: &str) -> Vec<String> {
    let Some((before, rest)) = tree.split_once('{') else {
        return vec![tree.to_owned()];
    };
    let inside = rest.rsplit_once('}').unwrap().0;
    let mut depth = 0;
    let branches = inside.split(|letter| {
        depth += i32::from(letter == '{') - i32::from(letter == '}');
        letter == ',' && depth == 0
    });
    branches
        .filter(|branch| !branch.is_empty())
        .flat_map(|branch| paths(&format!("{before}{branch}")))
        .collect()
}

/// The modules that this text of one uses; not those that it is inside of.
fn used(text: &str, own: &Module, modules: &BTreeMap<Module, String>) -> BTreeSet<Module> {
    let product = text.split("#[cfg(test)]\nmod tests").next().unwrap();
    let uses = product.split("\nuse ").skip(1);
    let trees = uses.filter_map(|rest| rest.split_once(';'));
    let trees = trees.map(|(tree, _)| tree.split_whitespace().collect::<String>());
    let paths = trees.flat_map(|tree| paths(&tree));
    let found = paths.filter_map(|path| {
        let mut place = own.clone();
        let mut names = path.split("::").peekable();
        match names.next()? {
            "crate" => place.clear(),
            "self" => {}
            "super" => {
                place.pop();
                while names.next_if_eq(&"super").is_some() {
                    place.pop();
                }
            }
            _ => return None,
        }
        for name in names {
            place.push(name.to_owned());
            if !modules.contains_key(&place) {
                place.pop();
                break;
            }
        }
        (!own.starts_with(&place)).then_some(place)
    });
    found.collect()
}

#[test]
fn no_file_uses_one_that_uses_it() {
    let root = root();
    let mut files = Vec::new();
    sources(&root, &mut files);
    let mut crates: BTreeMap<PathBuf, BTreeMap<Module, String>> = BTreeMap::new();
    for file in files {
        let (source, names) = module(&file);
        let text = format!("\n{}", fs::read_to_string(&file).unwrap());
        crates.entry(source).or_default().insert(names, text);
    }
    assert!(crates.len() > 30, "{}", crates.len());
    for (source, modules) in crates {
        let mut left: BTreeMap<&Module, BTreeSet<Module>> = modules
            .iter()
            .map(|(own, text)| (own, used(text, own, &modules)))
            .collect();
        // Whoever uses none of those that are left is none of a circle.
        loop {
            let names: BTreeSet<Module> = left.keys().map(|own| (*own).clone()).collect();
            left.retain(|_, uses| !uses.is_disjoint(&names));
            if left.len() == names.len() {
                break;
            }
        }
        let left: Vec<String> = left.keys().map(|own| own.join("::")).collect();
        assert!(left.is_empty(), "{}: {left:?}", source.display());
    }
}
