#!/bin/bash
# release.sh STEP FOLDER TARGET VERSION [ARGUMENT]: a step of `cargo release` that only runs programs. FOLDER
# is that of the files, TARGET the target folder. Run in the workspace's root.
set -euo pipefail
folder=$2 target=$3 version=$4

# The version of mdbook that makes the site.
mdbook=0.5.4

case $1 in
# The site, with the laboratory in the folder ARGUMENT.
book)
    env -u CARGO_BUILD_TARGET "${CARGO:-cargo}" install --quiet --locked \
        --no-default-features --features search --version "$mdbook" mdbook --root "$target/tools"
    "$target/tools/bin/mdbook" build docs --dest-dir "$target/book"
    cp --recursive --no-target-directory "$5" "$target/book/laboratory"
    tar --create --sort=name --gzip --file "$folder/singletrack-book-$version.tar.gz" \
        --directory "$target/book" .
    ;;
# The container image of the packages for the architecture ARGUMENT. In a container, and for root without
# all rights, no other isolation works.
image)
    name=singletrack-sim:$version
    podman build --quiet --isolation chroot --squash --tag "$name" \
        --file packaging/Containerfile.simulator "$target/debian"
    podman save --quiet --format oci-archive --output "$folder/singletrack-sim_${version}_$5.tar" "$name"
    ;;
checksums)
    cd "$folder"
    export LC_ALL=C
    sha256sum -- * >../SHA256SUMS
    mv ../SHA256SUMS .
    du --apparent-size --human-readable --all "$folder"
    ;;
esac
