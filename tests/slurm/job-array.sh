#!/bin/bash
# Campaigns as job arrays on a Slurm of one node: the merged files are those of one process, to
# the byte, and a job that fails can be run again alone.
#
#   job-array.sh FOLDER        FOLDER has singletrack and singletrack-faults
set -eu
here=$(dirname "$(realpath "$0")")
programs=$(realpath "$1")
if [ -z "${SLURM_CONF:-}" ]; then
    work=$(mktemp --directory)
    trap 'rm -rf "$work"' EXIT
    cd "$work"
    "$here/one-node.sh" "$work/slurm" 2 "$here/$(basename "$0")" "$programs"
    exit
fi

export PATH="$programs:$PATH" SHARDS=3
campaign="$here/../../packaging/slurm/campaign.sbatch"
array() {
    sbatch --parsable --wait --array="$1" "$campaign" "${@:2}" > sbatch.out
}
compare_files() {
    singletrack merge shard-*.jsonl --out merged.jsonl
    cmp merged.jsonl whole.jsonl
    rm shard-*.jsonl
}

faults="singletrack-faults --first-seed 46 --count 12"
$faults --threads 2 --json whole.jsonl > whole.txt
array 1-3 $faults
singletrack-faults --from shard-*.jsonl | cmp - whole.txt
compare_files
echo "faults: 3 jobs gave file and report of one process"

compare="singletrack compare --controllers p-ff,stanley --paths lane-change --speeds 1.0,1.5
    --conditions nominal --count 3"
$compare --json whole.jsonl --format csv > whole.csv
array 1-3 $compare
singletrack compare --from shard-*.jsonl --format csv | cmp - whole.csv
compare_files
echo "compare: 3 jobs gave file and table of one process"

# The second job can't write its file: the array fails, and merge names the missing shard.
mkdir shard-2.jsonl
if array 1-3 $faults; then
    echo "the array with a job that failed succeeded" >&2
    exit 1
fi
rmdir shard-2.jsonl
if singletrack merge shard-1.jsonl shard-3.jsonl > /dev/null 2> refused.txt; then
    echo "merge took two shards of three" >&2
    exit 1
fi
grep -q 'give also shard 2/3' refused.txt
array 2 $faults
$faults --json whole.jsonl > /dev/null
compare_files
echo "the job that failed was run again alone"
