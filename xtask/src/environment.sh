#!/bin/bash
# environment.sh FOLDER SOURCE MODULES: makes an environment of Python in the folder with the packages of
# SOURCE/requirements.txt, unless it is there with these, and its Python can import the modules, which
# commas separate. If there is a SOURCE/messages.py, that builds packages of messages of ROS, which are on
# no package index.
set -euo pipefail
folder=$1 source=$2 modules=$3
python=$folder/bin/python
is_ros=
[ ! -f "$source/messages.py" ] || is_ros=1

# Shows the output of a command only if it fails.
quietly() {
    local output
    output=$("$@" 2>&1) || { echo "$*: failed"$'\n'"$output" >&2 && exit 1; }
}

# What is imported is compiled then.
install() {
    quietly "$python" -m pip install --no-compile --disable-pip-version-check "$@"
}

required=$(cat "$source/requirements.txt" ${is_ros:+"$source/messages.py"})
# Written after the last successful installation. Its Python may have been removed or replaced.
if [ "$(cat "$folder/installed.txt" 2>/dev/null)" = "$required" ] &&
    "$python" -c "import $modules" >/dev/null 2>&1; then
    exit
fi
maker=$("$(dirname "$0")/prerequisites.sh" find find_python) || { echo "$maker" >&2 && exit 1; }
# The wheels of ROS write into the environment and start its Python again.
quietly "$maker" -m venv --clear ${is_ros:+--copies} "$folder"
echo "Installing Python packages into $folder"
# Their builds need it.
[ ! "$is_ros" ] || install wheel==0.48.0
install -r "$source/requirements.txt"
if [ "$is_ros" ]; then
    # Each with the package that it uses.
    quietly "$python" "$source/messages.py" "$source/ackermann_msgs" "$folder/build" std_msgs
    quietly "$python" "$source/messages.py" "$source/tf2_msgs" "$folder/build" geometry_msgs
fi
echo "$required" >"$folder/installed.txt"
