#!/bin/bash
# compile-lint-document COMPILER ARGUMENT...: compiles a crate as cargo asks the compiler to, lints it with
# clippy and, unless it is a test, documents it, up to the first that fails. Cargo takes a crate as
# compiled only if all succeed. `workspace.rs` lets cargo call a copy of this script.
#
# What is tested is the compiler's own output: clippy's driver does not optimise as the compiler does.
# Tests are not optimised where that takes longer than they run: the unit tests of a library compile all
# of it again. Nor are programs: what computes is in their libraries. Without optimisation both drivers
# generate the same code, and clippy's compiles and lints such a crate in one go.
set -euo pipefail
compiler=$1
shift

# beside PROGRAM: the one that comes with the compiler: beside it, or on the search path.
beside() {
    if [ -f "${compiler%/*}/$1" ]; then echo "${compiler%/*}/$1"; else echo "$1"; fi
}

# The arguments for clippy and rustdoc are the compiler's without those of its output and of the linker.
own=${CARGO_BIN_NAME-}
is_crate= has_library_root= is_test= is_program= is_example= has_library= previous=
kept=()
for argument; do
    pair="$previous $argument"
    previous=$argument
    case $pair in
    "--out-dir "* | "-l "* | "--emit "* | "--json "*) continue ;;
    "--crate-type bin") is_program=1 ;;
    esac
    case $argument in
    --out-dir | --out-dir=* | -l | -l=* | --emit | --emit=* | --json | --json=*) continue ;;
    --test) is_test=1 ;;
    "${own//-/_}="*) has_library=1 ;;
    examples/* | */examples/*) is_example=1 ;;&
    *src/lib.rs) has_library_root=1 ;;&
    *.rs) is_crate=1 ;;
    esac
    kept+=("$argument")
done

# A program, an example and a build script call the library, which computes: they are not optimised, but
# for two that have no library. `cargo bench`, which runs the benchmarks, compiles them in a profile of
# their own.
is_plain=$is_test$is_program
case ${CARGO_PKG_NAME-} in
singletrack-benches) is_plain=1 ;;
singletrack-simavr-process | singletrack-uno) is_plain=$is_test ;;
singletrack-commissioning) is_plain=$is_program ;;
singletrack-analysis | singletrack-control) if [ ! "$has_library_root" ]; then is_plain=$is_program; fi ;;
esac
first=("$compiler" "$@")
if [ "$is_plain" ]; then first=("$(beside clippy-driver)" "$@" -C opt-level=0); fi
[ "$is_crate" ] || exec "${first[@]}"
"${first[@]}" -D warnings

# look PROGRAM OPTION...: without messages about files, of which cargo waits for the compiler's own.
look() {
    "$@" "${kept[@]}" --json=diagnostic-rendered-ansi --out-dir "$(dirname "$0")/results"
}

# Clippy reads a library once, together with its unit tests, unless cargo compiles none of them.
is_library=
if [ "$has_library_root" ] && [ ! "$is_test" ]; then is_library=1; fi
has_unit_tests() {
    ! sed -n '/^\[lib\]/,/^\[/p' "$CARGO_MANIFEST_DIR/Cargo.toml" | grep -x 'test = false' >/dev/null
}
if [ ! "$is_plain" ] && ! { [ "$is_library" ] && has_unit_tests; }; then
    look "$(beside clippy-driver)" --emit=metadata
fi

# What `cargo doc` would document: a library, or a program without a library of its name; no test, with or
# without a harness of its own, no example, and no build script.
if [ "$own" ]; then
    [ "$is_test$is_example$has_library" ] || look "$(beside rustdoc)" -D warnings
elif [ "$is_library" ]; then
    look "$(beside rustdoc)" -D warnings
fi
