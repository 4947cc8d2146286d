set -eEuo pipefail
# For job control: programs in the background listen to Ctrl-C.
set -m
block=
at() { block=$1; echo "== $block" >&2; }
trap 'echo "$block: failed: $BASH_COMMAND" >&2' ERR
trap 'kill $(jobs -p) 2> /dev/null || true' EXIT

# Ctrl-C after two seconds; the command must end with success, or by the signal.
interrupted() {
    local status=0
    timeout --preserve-status --signal=INT --kill-after=5 2 bash -c "$1" || status=$?
    test $status = 0 || test $status = 130
}

# The daemon that the page has started, or the one at SINGLETRACK_SOCKET, is ready.
await_ready() {
    export SINGLETRACK_SOCKET=${SINGLETRACK_SOCKET:-/tmp/singletrackd.sock}
    for _ in $(seq 100); do
        if singletrack status 2> /dev/null | grep -q '^ready'; then return; fi
        sleep 0.1
    done
    singletrack status
    return 1
}

# A simulated car with its daemon, for pages that talk of one that runs.
car() {
    if test -z "${SINGLETRACK_SOCKET:-}"; then
        singletrack-sim --quiet &
        sed -e 's|^port = .*|port = "/tmp/singletrack-board"|' \
            -e 's|^server = .*|server = "127.0.0.1"|' \
            -e 's|^#directory = .*|directory = "/tmp/records"|' \
            -e 's|^#path = .*|path = "/tmp/singletrackd.sock"|' \
            -e '/^\[tuning\]/,/^\[/ s|^#enabled = .*|enabled = true|' \
            -e '/^\[tuning\]/,/^\[/ s|^# gain_per_s = .*|gain_per_s = [1.0, 8.0]|' \
            -e '/^\[tuning\]/,/^\[/ s|^# point_distance_m = .*|point_distance_m = [0.35, 0.36]|' \
            -e 's|^#require_calibration = .*|require_calibration = false|' \
            host/daemon/singletrackd.example.toml > /tmp/the-car.toml
        singletrackd --config /tmp/the-car.toml &
    fi
    await_ready
}

# `cargo run ... --example NAME`: the one that `cargo test --no-run` has built.
cargo() {
    while test "$1" != --example; do shift; done
    local example=$2
    shift 2
    if test "${1:-}" = --; then shift; fi
    "$EXAMPLES/$example" "$@"
}

finish() {
    trap - ERR
    kill $(jobs -p) 2> /dev/null || true
    wait
}
