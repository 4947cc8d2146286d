#!/bin/bash
# debian.sh STAGE PACKAGES ARCHITECTURE VERSION DATE [PROFILE]: makes and checks the packages in the folder
# PACKAGES, in a copy of `packaging` in the folder STAGE, which has a file libraries.txt in a folder for
# each package. Empties PACKAGES of those for ARCHITECTURE, also of other versions, which an installation
# by a pattern would take too. Run in the workspace's root, with the variables PROGRAMS, EMULATOR and IMAGE
# of debian/rules. With one of its build profiles the package is only checked.
set -euo pipefail
mkdir -p "$2" "$1/singletrack-ros"
rm -f "$2"/*_"$3".deb
cp -r packaging/. "$1"
cat >"$1/debian/changelog" <<END
singletrack ($4) bookworm; urgency=medium

  * CHANGELOG.md of the sources lists the changes.

 -- $(sed -n 's/^Maintainer: //p' packaging/debian/control)  $(date --utc --rfc-email --date "$5")
END
export SOURCE=$PWD DEB_RULES_REQUIRES_ROOT=no DEB_BUILD_PROFILES=${6-}
# There is nothing to test.
export DEB_BUILD_OPTIONS=nocheck
export COMPRESSION=6
# A third larger, in an eighth of the time.
[ -z "${6-}" ] || COMPRESSION=1
cd "$1"
exec dpkg-architecture --host-arch "$3" --force --command debian/rules binary inspect
