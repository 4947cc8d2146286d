#!/bin/bash
# Starts a Slurm of one node from Debian's packages (munge, slurmctld, slurmd, slurm-client),
# runs a command with it, and stops it. It has its own key, ports, folder and network, and
# disturbs no other Slurm.
#
#   one-node.sh FOLDER CPUS COMMAND [ARGUMENT...]
set -eu
# The path of a user may lack the folder of the daemons.
PATH=$PATH:/usr/sbin

# With 127.0.0.1 alone no name can be resolved (AI_ADDRCONFIG).
loopback='ip link set lo up && ip address add 127.0.0.2/8 dev lo && exec "$@"'
if [ "${ONE_NODE_NETWORK:-}" != private ]; then
    export ONE_NODE_NETWORK=private
    if [ "$(id -u)" = 0 ]; then
        exec unshare --net sh -c "$loopback" sh "$0" "$@"
    fi
    # Root in a namespace brings the network up. Slurm must not be root there: it could not
    # drop groups.
    exec unshare --map-root-user --net sh -c "$loopback" sh \
        unshare --user --map-user="$(id -u)" --map-group="$(id -g)" "$0" "$@"
fi
folder=$(realpath "$1") cpus=$2
shift 2

mkdir -p "$folder"/{munge,state,spool}
chmod 700 "$folder/munge"
head -c 128 /dev/urandom > "$folder/munge/key"
chmod 400 "$folder/munge/key"
export SLURM_CONF="$folder/slurm.conf"
cat > "$SLURM_CONF" <<CONF
ClusterName=one
SlurmctldHost=localhost(127.0.0.1)
SlurmUser=$(id -un)
SlurmdUser=$(id -un)
AuthType=auth/munge
AuthInfo=socket=$folder/munge/socket
StateSaveLocation=$folder/state
SlurmdSpoolDir=$folder/spool
SlurmctldPidFile=$folder/slurmctld.pid
SlurmdPidFile=$folder/slurmd.pid
SlurmctldLogFile=$folder/slurmctld.log
SlurmdLogFile=$folder/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
MpiDefault=none
ReturnToService=2
NodeName=localhost NodeHostname=localhost NodeAddr=127.0.0.1 CPUs=$cpus State=UNKNOWN
PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE State=UP
CONF

daemons=()
# slurmd first: it reports the end of a job to slurmctld, signed by munged.
stop() {
    for ((one = ${#daemons[@]} - 1; one >= 0; one--)); do
        for _ in $(seq 40); do
            kill "${daemons[one]}" 2> /dev/null || continue 2
            sleep 0.05
        done
        kill -KILL "${daemons[one]}" 2> /dev/null || true
    done
}
trap stop EXIT

munged --foreground --force --key-file="$folder/munge/key" --socket="$folder/munge/socket" \
    --pid-file="$folder/munge/pid" --log-file="$folder/munge/log" \
    --seed-file="$folder/munge/seed" 2> "$folder/munge/errors" &
daemons+=($!)
slurmctld -D > "$folder/slurmctld.out" 2>&1 &
daemons+=($!)
slurmd -D -N localhost > "$folder/slurmd.out" 2>&1 &
daemons+=($!)

for _ in $(seq 100); do
    if sinfo --noheader --format=%t 2> /dev/null | grep -qx idle; then
        "$@"
        exit
    fi
    sleep 0.1
done
echo "Slurm did not start within 10 s:" >&2
tail "$folder"/*.out "$folder"/*.log "$folder/munge/errors" >&2
exit 1
