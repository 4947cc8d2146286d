#!/bin/bash
# units.sh FOLDER: verifies the services' units with systemd, and their exposure. Run in the workspace's
# root. Lays the units out in the folder.
set -euo pipefail

# Limit for systemd's exposure level, 0 to 10. gpsd has 9.6, chrony 3.7.
max_exposure=1.6

# check FOLDER NAME [DROP_IN]: checks a unit, with a drop-in.
check() {
    mkdir -p "$1"
    # The package need not be installed: an existing program takes the place of its programs.
    sed -E 's|=/usr/bin/singletrackd? |=/bin/true |' "packaging/$2" >"$1/$2"
    [ -z "${3-}" ] || install -D --mode 644 --target-directory "$1/$(dirname "$3")" "packaging/$3"
    # systemd succeeds even with unknown keys, of which it warns.
    if ! printed=$(systemd-analyze verify --man=no "$1/$2" 2>&1) || [ -n "$printed" ]; then
        echo "systemd-analyze verify $1/$2:" >&2
        echo "$printed" >&2
        exit 1
    fi
    local security="systemd-analyze security --offline=yes"
    if ! report=$($security --no-pager --threshold=${max_exposure/./} "$1/$2"); then
        tail -n 1 <<<"$report" >&2
        echo "the limit is $max_exposure; \`$security packaging/$2\` lists the reasons" >&2
        exit 1
    fi
    exposure=$(sed -n 's/.*Overall exposure level for .*: \([0-9.]*\).*/\1/p' <<<"$report")
    echo "${3-$2}: verified, exposure $exposure"
}

check "$1/plain" singletrackd.service
check "$1/xu4" singletrackd.service singletrackd.service.d/xu4.conf
check "$1/plain" singletrack-page.service
check "$1/plain" singletrack-live.service
