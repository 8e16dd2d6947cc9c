#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
#
# Tests relidar-dev on a tiny synthetic street: all its measurements, and invalid input.
#
#   dev_test.sh RELIDAR RELIDAR_DEV WORK_FOLDER
#
# Exits 77 (skipped) if there is no Vulkan device, or fails if RELIDAR_REQUIRE_GPU=1.
set -uo pipefail
usage="usage: dev_test.sh RELIDAR RELIDAR_DEV WORK_FOLDER"
program=$(realpath "${1:?$usage}") relidar=$(realpath "${2:?$usage}")
tests=$(realpath "$(dirname "${BASH_SOURCE[0]}")")
work=${3:?$usage}
rm -rf "$work" && mkdir -p "$work" && cd "$work" || exit 1
source "$tests/checks.sh"

good --help
for command in bench pipelines; do says "^  $command "; done
bad 2 '--scene: .*"D", .*A, B .*C' bench --scene D
bad 2 '--surfels: .*0, .*1 ' bench --surfels 0
bad 2 '--surfels: .*"many"' bench --surfels many
bad 2 '--rays: .*"64x", .*waymo, kitti' bench --rays 64x
bad 2 '--rays: .*20000x20000' bench --rays 20000x20000
bad 2 'trace.chunk: .*"65"' bench --chunk 65
bad 2 '--proxy: .*"cube", .*auto, triangles, boxes' bench --proxy cube
bad 2 'sh_direction: .*"normal"' bench --sh normal
bad 2 'trace.keep_hits: .*"-1"' bench --keep-hits -1
bad 2 '--actors: .*1.5 .*"1,1.5"' bench --actors 1,1.5
bad 2 '--actors: .*"x"' bench --actors x
bad 2 '--repeat: .*0, .*1 ' bench --repeat 0
bad 2 'steps: .*--run' bench --steps 3
bad 2 '--steps: .*--scans' bench --run none --steps 3 --scans 3
bad 2 '--run: .*--scene, --surfels .*--rays' bench --run run --rays kitti
bad 2 "train" train street
if ! "$program" list devices >/dev/null 2>&1; then
    [[ ${RELIDAR_REQUIRE_GPU:-0} != 1 ]] || fail "no Vulkan device, and RELIDAR_REQUIRE_GPU=1"
    skipped=1
    finish_checks
fi

mkdir street
printf 'seed = 5\nn_frames = 12\nrows = 8\ncolumns = 96\n' >street/street.toml
check "no run to measure" "$program" train street --out run --preset quick --set train.refine_poses=none --set init.actor_min_points=10 \
    --set train.iterations=6 --set dataset.test_every=5 --no-eval --quiet
good bench --surfels 2000 --rays 16x64 --repeat 2 --json numbers/bench.json
for kernel in scene/activate accel/build accel/refit diff/forward/trace diff/backward/trace diff/optimizer/adam "complete iteration" "move of one instance"; do says "^$kernel +[0-9.]+ +[0-9.]+ +[0-9.]+ +([0-9.]+ +[0-9.]+|- +-)$"; done
says "^floors .*[0-9.]+ GB/s"
says "^forward +[0-9.]+ Mrays/s, 0\.[0-9]+ "
exists numbers/bench.json
for key in forward_mrays_per_s backward_mrays_per_s hits_per_ray bytes_per_surfel accel_bytes_per_surfel copy_bytes_per_s median_over_floor; do
    check "bench.json lacks $key" grep -Eq "\"$key\": [0-9]*[1-9.]" numbers/bench.json
done
# Expected bytes, computed by hand. Surfels: 2000 x 58 floats. Adam reads and writes 3
# arrays of them, and reads a mark for each surfel and the gradients of marked surfels.
# Records: 64 B from 40 B and 3 x 16 harmonics. Rays: 1024 with 36 B rendered, 12 B
# measured and 20 B of gradients.
with_gradient=$(sed -n 's/.*"surfels_with_gradient": \([0-9]*\).*/\1/p' numbers/bench.json)
check "bench.json: no surfel has a gradient, or more than there are" test "$with_gradient" -gt 0 -a "$with_gradient" -le 2000
for floor in "diff/optimizer/adam\": $((2000 * (6 * 232 + 4) + with_gradient * 232))" "scene/activate\": 592000" "diff/loss/image_loss\": 69632"; do
    check "bench.json: other bytes than $floor" grep -Eq "\"$floor(\.0)?,?$" numbers/bench.json
done
good bench --surfels 2000 --rays 16x64 --repeat 1 --deterministic --keep-hits 0 --json gather.json
for kernel in backward/sort diff/backward/gather; do says "^$kernel +[0-9.]+"; done
check "bench --deterministic does not gather" grep -q '"reduction": "gather"' gather.json
check "bench --keep-hits 0 keeps hits" grep -q '"keep_hits": 0' gather.json
good bench --run run --no-backward --repeat 1 --json render.json --quiet
check "bench --quiet prints" test ! -s out -a ! -s err
check "bench --run: other rays than the run's 8 x 96" grep -q '"rays": 768' render.json
check "bench --no-backward has a backward pass" grep -q '"backward_mrays_per_s": null' render.json
good bench --run run --steps 2
says " 768 rays per step"
says "^diff/forward/trace +1 +[0-9.]+ +[0-9.]+%$"
says "^between kernels +-?[0-9.]+ +-?[0-9.]+%$"
says "^step, wall time +[0-9.]+ +100.0%$"
bad 2 "--steps: .*501, .*500" bench --run run --steps 501
bad 3 "nowhere: " bench --run nowhere --json lost.json
bad 2 "--json: .*--steps" bench --run run --steps 2 --json steps.json
good bench --actors 1,3 --repeat 2
says "^ +3 +shared +1000 +[0-9.]+ +[0-9.]+ +[0-9.]+ +[0-9.]+ +[0-9.]+ +0$"
says "^ +3 +separate +3000 +[0-9.]+ +[0-9.]+ +[0-9.]+ +[0-9.]+ +[0-9.]+ +0$"
check "moving actors rebuilds bottom levels" test "$(grep -c ' 0$' out)" = 4
absent lost.json
good pipelines --traversal software --kernel diff/optimizer/adam --tsv
says "^kernel	constants	workgroup"
says "^diff/optimizer/adam	"
finish_checks
