#!/bin/sh
# Checks the proofs of `singletrack stability` and `singletrack certify` with the programs of this folder, which share nothing with it.
#
#     lab/certificates/check.sh PROGRAM FOLDER
#
# PROGRAM is singletrack-lab; what it writes is left in FOLDER.
set -eu
program=$1
folder=$2
own=$(dirname "$0")
mkdir -p "$folder"

# The paper's car without a servo; the simulated car; the law of the appendix.
"$program" stability losses --law front-point --speeds 2,3,5 --certificates "$folder/patterns.json"
"$program" stability losses --law front-point --speeds 3 --delay-ms 7 --steering-lag-ms 40 \
    --steering-dead-time-ms 2 --servo-frame 2 --yaw-rate-age-ms 5 --predicted-ticks 2 --longest-ms 300 \
    --certificates "$folder/servo.json"
"$program" stability losses --law velocity-point --speeds 3 --dl 0.01 --position-gain 1 --longest-ms 400 \
    --certificates "$folder/appendix.json"
"$program" stability losses --law front-point --speeds 3,5 --bursts-ms 100,200,300 \
    --certificates "$folder/random.json"
for proof in patterns servo appendix random; do
    python3 "$own/check_losses.py" "$folder/$proof.json"
    python3 "$own/check_losses.py" --changed "$folder/$proof.json"
done

# Small regions, which take seconds; the second one reaches beyond its steering stop.
"$program" stability attraction --law front-point --speeds 2 --most-yaw 0.02 --certificates "$folder/attraction.json"
"$program" stability attraction --law front-point --speeds 1 --most-yaw 0.03 --max-steering 0.015 \
    --certificates "$folder/stop.json"
python3 "$own/check_attraction.py" "$folder/attraction.json"
python3 "$own/check_attraction.py" --changed "$folder/attraction.json"
python3 "$own/check_attraction.py" "$folder/stop.json"

sed '/^\[safety_filter\]/,/^$/ s/^#enabled = false/enabled = true/' host/daemon/singletrackd.example.toml > "$folder/car.toml"
"$program" certify "$folder/car.toml" --out "$folder/filter.json"
python3 "$own/check_filter.py" "$folder/filter.json" "$folder/car.toml"
python3 "$own/change_filter.py" "$folder/filter.json"

for car in paper f1tenth dart; do
    "$program" stability one-length --vehicle "tools/vehicles/$car.toml" --format json > "$folder/$car.json"
done
python3 "$own/check_one_length.py" "$folder/paper.json" "$folder/f1tenth.json" "$folder/dart.json"
