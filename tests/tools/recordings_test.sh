#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
#
# Recordings of `relidar render` read by others' readers: @mcap/core with protobufjs and @foxglove/rosmsg2-serialization, of npm:
#   npm install --prefix FOLDER @mcap/core protobufjs @foxglove/rosmsg @foxglove/rosmsg2-serialization
#
#   recordings_test.sh RELIDAR WORK_FOLDER READERS       READERS: that FOLDER; $RELIDAR_READERS instead where it is set
#
# Exits 77 (skipped) where there is no node, no such package or no Vulkan device.
set -uo pipefail
relidar=$(realpath "${1:?usage: recordings_test.sh RELIDAR WORK_FOLDER READERS}")
tests=$(realpath "$(dirname "${BASH_SOURCE[0]}")")
work=${2:?usage: recordings_test.sh RELIDAR WORK_FOLDER READERS}
readers=${RELIDAR_READERS:-${3:-}}
command -v node >/dev/null || { echo "no node"; exit 77; }
[[ -d $readers/node_modules ]] || { echo "no packages in $readers"; exit 77; }
readers=$(realpath "$readers")
if ! "$relidar" devices >/dev/null 2>&1; then
    echo "no Vulkan device"
    [[ ${RELIDAR_REQUIRE_GPU:-0} == 1 ]] && exit 1
    exit 77
fi
rm -rf "$work" && mkdir -p "$work/street" && cd "$work" || exit 1
fail() { printf 'FAILED: %s\n' "$*"; exit 1; }

printf 'seed = 5\nn_frames = 12\nrows = 8\ncolumns = 96\n' >street/street.toml
"$relidar" train street --out run --preset quick --set train.pose_register=false --set init.actor_min_points=10 \
    --set train.iterations=6 --no-eval --quiet || fail "no run"
for frame in sensor deskewed; do   # frame 0 begins before second 0
    flags=()
    [[ $frame == sensor ]] || flags=(--deskew)
    "$relidar" render run --frames 0:4 --out "$frame" --format mcap,rosbag,ply --quiet "${flags[@]}" || fail "render"
    node "$tests/read_recordings.cjs" "$readers" "$frame"
    code=$?
    [[ $code != 77 ]] || exit 77
    [[ $code == 0 ]] || fail "recordings in the frame '$frame'"
done

# The readers notice damage: a flipped bit in a chunk.
cp -r sensor damaged
size=$(stat -c %s damaged/scans.mcap)
printf '\x5a' | dd of=damaged/scans.mcap bs=1 seek=$((size / 2)) conv=notrunc status=none
! node "$tests/read_recordings.cjs" "$readers" damaged >/dev/null 2>&1 || fail "damage is not noticed"
echo "recordings: read by @mcap/core, protobufjs and @foxglove/rosmsg2-serialization"
