#!/bin/bash
# debian.sh STAGE PACKAGES ARCHITECTURE VERSION DATE: copies `packaging` to the folder STAGE, with
# debhelper's changelog. Empties the folder PACKAGES of the packages for ARCHITECTURE, also of other
# versions, which an installation by a pattern would take too. Run in the workspace's root.
set -euo pipefail
rm -rf "$1" "$2"/*_"$3".deb
mkdir -p "$2" "$1/singletrack" "$1/singletrack-ros"
cp -r packaging/. "$1"
cat >"$1/debian/changelog" <<END
singletrack ($4) bookworm; urgency=medium

  * CHANGELOG.md of the sources lists the changes.

 -- $(sed -n 's/^Maintainer: //p' packaging/debian/control)  $(date --utc --rfc-email --date "$5")
END
