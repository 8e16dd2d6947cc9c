#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
#
# Reads recordings of `relidar render` with readers of other projects from npm: @mcap/core
# with protobufjs and @foxglove/rosmsg2-serialization.
#   npm install --prefix FOLDER @mcap/core fzstd protobufjs @foxglove/rosmsg @foxglove/rosmsg2-serialization
# Every cloud, transformed to the world by the transforms of the recording, must equal the
# output of `--frame world` (read_recordings.cjs).
#
#   recordings_test.sh RELIDAR WORK_FOLDER READERS
#
# READERS is the FOLDER of npm; $RELIDAR_READERS replaces it if set.
#
# Exits 77 (skipped) if node, a package or a Vulkan device is missing.
set -uo pipefail
relidar=$(realpath "${1:?usage: recordings_test.sh RELIDAR WORK_FOLDER READERS}")
tests=$(realpath "$(dirname "${BASH_SOURCE[0]}")")
work=${2:?usage: recordings_test.sh RELIDAR WORK_FOLDER READERS}
readers=${RELIDAR_READERS:-${3:-}}
command -v node >/dev/null || { echo "no node"; exit 77; }
[[ -d $readers/node_modules ]] || { echo "no packages in $readers"; exit 77; }
readers=$(realpath "$readers")
rm -rf "$work" && mkdir -p "$work/street" && cd "$work" || exit 1
source "$tests/checks.sh"
need_device

# compare NAME "SUBFOLDER=TOPIC=FRAME ..." FLAGS... -- ONLY_FLAGS...: renders NAME in each
# of $frames (the sensor frame, deskewed, the world) with FLAGS. Renderings with
# recordings also use ONLY_FLAGS. Then reads the recordings.
frames=("sensor" "deskewed --deskew" "world --frame world")
compare() {
    local name=$1 sensors=$2 flags=() recording=() frame code
    shift 2
    while (($#)) && [[ $1 != -- ]]; do flags+=("$1"); shift; done
    recording=("${@:2}")
    "$relidar" render "$run" --out "$name/truth" --format ply --frame world --quiet "${flags[@]}" || { fail "$name: render"; return; }
    for frame in "${frames[@]}"; do
        local folder=$name/${frame%% *} how=()
        [[ $frame == sensor ]] || read -ra how <<<"${frame#* }"
        "$relidar" render "$run" --out "$folder" --format mcap,rosbag,ply --quiet "${flags[@]}" "${recording[@]}" "${how[@]}" || fail "$folder: render"
        # shellcheck disable=SC2086
        node "$tests/read_recordings.cjs" "$readers" "$run" "$folder" "$name/truth" $sensors
        code=$?
        [[ $code != 77 ]] || exit 77
        check "$folder: recordings" test "$code" = 0
    done
}

# train STREET RUN: trains a run on a street.toml.
train() {
    "$relidar" train "$1" --out "$2" --preset quick --set train.refine_poses=none --set init.actor_min_points=10 \
        --set train.iterations=6 --no-eval --quiet || { fail "no run"; exit 1; }
}

run=run
printf 'seed = 5\nn_frames = 12\nrows = 8\ncolumns = 96\n' >street/street.toml
train street run
# A lane change of 3.5 m in 1.2 s, and a curve with poses 15 degrees apart.
awk 'BEGIN { pi = 3.14159265358979; print "time_s,x,y,z,yaw_deg"; for (i = 0; i <= 24; ++i) { t = 0.05 * i; u = pi * t / 1.2
    printf "%.4f,%.6f,%.6f,1.73,%.6f\n", t, -8 + 16 * t, -1.75 * cos(u), atan2(1.75 * sin(u) * pi / 1.2, 16) * 180 / pi } }' >lane.csv
awk 'BEGIN { pi = 3.14159265358979; print "time_s,x,y,z,yaw_deg"; for (i = 0; i <= 6; ++i) { t = 0.25 * i; a = pi / 3 * t
    printf "%.4f,%.6f,%.6f,1.73,%.6f\n", t, -8 + 7 * sin(a), -2 + 7 * (1 - cos(a)), a * 180 / pi } }' >bend.csv
printf '%s\n' '{"sensors": [{"name": "front", "sensor": "VLP-16:300x10", "translation_m": [2, 0, 0.3], "yaw_pitch_roll_deg": [20, 5, 0]},' \
    ' {"name": "2nd-rear", "sensor": "VLP-16:200x20", "translation_m": [-2, 0.6, 0.5], "yaw_pitch_roll_deg": [180, -10, 3]}]}' >rig.json
alone=".=/lidar/points=lidar"
rig="front=/lidar/front/points=front 2nd-rear=/lidar/_2nd_rear/points=2nd-rear"

compare own "$alone" --frames 0:4 --channels normal,spread   # frame 0 starts before second 0
compare overlapping "$alone" --trajectory lane.csv --times 0.2:0.3:0.02 --sensor VLP-16:300x10
compare at_once "$alone" --trajectory lane.csv --times 0.2:0.4:0.1 --sensor VLP-16:300x10 --set sensor.rolling_shutter=false
compare rig "$rig" --trajectory lane.csv --times 0.2:0.5:0.1 --sensor rig.json --channels spread,normal
compare bend "$rig" --trajectory bend.csv --times 0.2:1:0.1 --sensor rig.json --offset 0,1,0,10
compare rig_of_log "$rig" --frames 3:6 --sensor rig.json
compare merged "$alone" --trajectory bend.csv --times 0.2:0.4:0.1 --sensor rig.json --merge --channels normal

# Coordinates of a map, for which single precision has steps of 0.25 m.
cp -r run mapped
node -e 'const fs = require("fs"), run = JSON.parse(fs.readFileSync("mapped/scene.json"));
    run.world_offset_m = [500000, 4000000, 100], fs.writeFileSync("mapped/scene.json", JSON.stringify(run))'
run=mapped
compare map "$alone" --frames 2:4
run=run

# LiDARs are mounted in base_link, and each topic contains the name of its LiDAR.
mkdir two && printf 'seed = 5\nn_frames = 6\nrig = "../rig.json"\n' >two/street.toml
train two run_of_two
run=run_of_two
compare first .=/lidar/front/points=front --frames 1:4
# The deskewed and world frames are tested above with the same kinds of sensors and names.
frames=("sensor")
compare second .=/lidar/_2nd_rear/points=2nd-rear --frames 1:4 --lidar 2nd-rear --sensor VLP-16:300x10
run=run
compare named ".=/sensing/front/pointcloud=front_lidar" --trajectory lane.csv --times 0.2:0.3:0.1 --sensor VLP-16:300x10 \
    -- --topic /sensing/front/pointcloud --frame-id front_lidar
compare rig_named "front=/sensing/front/points=front_link 2nd-rear=/sensing/_2nd_rear/points=2nd-rear_link" --frames 3:5 --sensor rig.json \
    -- --topic "/sensing/{name}/points" --frame-id "{name}_link"

# A new rendering must replace the single recording of a rig.
[[ "$(ls rig/sensor | tr '\n' ' ')" == "2nd-rear front rosbag.mcap scans.json scans.mcap " ]] || fail "a rig's folder holds $(ls rig/sensor | tr '\n' ' ')"
"$relidar" render run --frames 3:4 --sensor rig.json --out rig/sensor --quiet 2>err && fail "a rig's recordings were overwritten unasked"
grep -q "rig/sensor: .*contains" err || fail "another message than that of a folder that is taken: $(cat err)"
"$relidar" render run --frames 3:4 --sensor rig.json --out rig/sensor --quiet --force || fail "a rig rendered over another"
[[ "$(ls rig/sensor | tr '\n' ' ')" == "2nd-rear front " ]] || fail "a new rendering left the old one's recordings"

# The readers must detect damage: a flipped bit in a chunk.
cp -r own/sensor damaged
size=$(stat -c %s damaged/scans.mcap)
printf '\x5a' | dd of=damaged/scans.mcap bs=1 seek=$((size / 2)) conv=notrunc status=none
! node "$tests/read_recordings.cjs" "$readers" run damaged own/truth $alone >/dev/null 2>&1 || fail "damage is not noticed"
finish_checks
