#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
#
# relidar tables on a little of KITTI-360 and Waymo Open: parts that are there are trained, rendered and scored; one that is not, fails or
# has no labels is a row that says so; the same command goes on; cells of the tables are the scores of the runs.
#
#   tables_test.sh RELIDAR PAPER_FOLDERS [WORK_FOLDER]
#
# Exits 77 (skipped) where there is no Vulkan device, or fails there with RELIDAR_REQUIRE_GPU=1.
set -uo pipefail
relidar=$(realpath "${1:?usage: tables_test.sh RELIDAR PAPER_FOLDERS [WORK_FOLDER]}")
folders=$(realpath "${2:?usage: tables_test.sh RELIDAR PAPER_FOLDERS [WORK_FOLDER]}")
tests=$(realpath "$(dirname "${BASH_SOURCE[0]}")")
work=${3:-$(mktemp -d)}
rm -rf "$work" && mkdir -p "$work" && cd "$work" || exit 1
source "$tests/checks.sh"
unset RELIDAR_LPIPS_WEIGHTS

trainings() { grep -c '^\$ relidar train' "$1/batch.log"; }
has() { check "$1 lacks: $2" grep -Eq -- "$2" "$1"; }
lacks() { check "$1 has: $2" bash -c '! grep -Eq -- "$2" "$1"' _ "$1" "$2"; }

# Column of a CSV in the row whose first cells match.
cell() {
    awk -F, -v want="$3" -v begins="$2" 'NR == 1 { for (i = 1; i <= NF; ++i) if ($i == want) at = NF - i }
        NR > 1 && index($0, begins) == 1 { print $(NF - at) }' "$1"
}
# The mean that a run's metrics.json has.
scored() { awk -v name="\"$2\":" '$1 == name { gsub(/,/, "", $2); print $2; exit }' "$1"; }

"$folders" . || { echo "FAILED: paper_folders"; exit 1; }
rm -rf KITTI-360/data_3d_bboxes/train
tiny=(--preset quick --set train.iterations=2 --set refine.epochs=1 --set init.unlabelled_movers=removed --set train.refine_poses=none
    --set sensor.calibrate=none --set init.voxel_m=1)
tables=(tables paper --kitti360 KITTI-360 --waymo waymo --out tables)

# bad_rows OUT ARGS...: the tables of parts of which none is there.
bad_rows() {
    "$relidar" tables paper --waymo waymo --parts kd1,wd1 --out "$@" >out 2>err
    check "no part is there: exit code $?, expected 3" test $? = 3
}

wrong() {
    bad 2 "TABLES: .*others not in \{paper\}" tables others --out x
    bad 2 "out is required" tables paper
    bad 2 "tables: found no dataset, expected --kitti360 DIR, --waymo DIR, or both" tables paper --out x
    bad 2 '--parts: found "kd7", did you mean kd[1-6]\? *.*expected some of ks1,' tables paper --kitti360 KITTI-360 --out x --parts kd1,kd7
    bad 2 '--preset: found "papre", did you mean paper\?' tables paper --kitti360 KITTI-360 --out x --preset papre
    bad 2 "setting train.iteration: unknown key" tables paper --kitti360 KITTI-360 --out x --set train.iteration=5
    bad 3 "none.safetensors" tables paper --kitti360 KITTI-360 --out x --lpips-weights none.safetensors
    absent x
    bad_rows x   # needs no device
    has err "^relidar: note: kd1-paper: missing: no --kitti360 given"
    has err "^relidar: note: wd1-paper: missing: dataset.sequence: found 'wd1', expected how one of the 1 segments of .* begins"
    has x/tables.md "LiDAR-RT, as printed \| 10 \| 42.7 \| 0.41 \| 3.4671 \| 0.0512 \| 0.1016 \| 0.8406 \| 27.6755 \| 0.1115 "
    has x/tables.md "LiDAR-RT, as printed \| 8 \| 20.1 \| 1.37 \| 6.4577 \| 0.0340 "
    has x/tables.md "relidar, .quick. \| 0 of 8|relidar, .paper. \| 0 of 8"
    absent x/parts.toml
    absent x/ablation.csv
    bad_rows x --ablation
    has x/tables.md "w/o L_CD, as printed \| 6 \| – \| – \| 3.5053 "
    has x/tables.md "w/o R_hit: one drop logit, as printed \| 6 \| – \| – \| 4.5482 "
    has x/tables.md "^\| relidar, .paper., w/o L_CD \| 0 of 6"
    has x/ablation.csv '^"3D Gaussians",all,"printed",29(.0)?,,3.6716,,0.1145,'
}

# Three parts, of which one has no labels, and one that is not there; then the same again.
first_time() {
    "$relidar" "${tables[@]}" --parts kd1,kd2,kd3,ws1 "${tiny[@]}" >out 2>err
    check "exit code $?, expected 3: something is missing" test $? = 3
    has err "note: kd3-quick: missing: frames 8121:8171: no scan of .* lies in it"
    has err "note: kd1-quick: done, but 3 of 50 frames were there, 1 of 4 to be held out; no box was labelled"
    has err "note: kd2-quick: done, but 3 of 50 frames were there, 1 of 4 to be held out\$"
    has err "^relidar: tables: 1 of 4 rows are missing, 3 lack frames or labels"
    for part in kd1 kd2 ws1; do
        has "tables/$part-quick/job.json" '"state": "done"'
        exists "tables/$part-quick/scans/scans.json"
    done
    has tables/tables.md '^\| relidar, .quick. \| 2 of 10 \|'
    has tables/tables.md '^\| relidar, .quick. \| 1 of 8 \|'
    has tables/tables.md '^\| kd3 \| relidar, .quick. \| missing: '
    has tables/tables.md 'train.iterations=2'
    has tables/kd2-quick/run/config.toml '^grid = "kitti360"'
    has tables/ws1-quick/run/config.toml '^grid = "native"'
    has tables/kd2-quick/run/scene.json '"index": ?4960, .*test|4960'
    for column in peer/depth_rmse_m peer/cd_sq_m2 peer/f_score strict/drop_rmse strict/f_5cm; do
        local there expected
        there=$(cell tables/table2_kitti360.csv '"relidar, quick",kd2' "$column")
        expected=$(scored tables/kd2-quick/run/metrics.json "$column")
        check "$column of kd2: '$there' in the table, '$expected' in metrics.json" test -n "$there" -a "$there" = "$expected"
    done
    check "LPIPS without weights has a value" test -z "$(cell tables/table2_kitti360.csv '"relidar, quick",kd2' peer/depth_lpips)"
}

# Nothing is trained again; a part that came since is tried, and fails alone.
goes_on() {
    local scans
    scans=$(echo KITTI-360/data_3d_raw/*/velodyne_points/data)
    printf 'no points' >"$scans/0000008121.bin"
    "$relidar" "${tables[@]}" --parts kd1,kd2,kd3,ws1 "${tiny[@]}" >out 2>err
    check "exit code $?, expected 3: a part failed" test $? = 3
    has err "^relidar: 1 of 4 jobs failed, job kd3-quick: .*timestamps.txt: 4969 lines, frame 8121 needs .*; --retry-failed tries again"
    has err "^relidar: note: kd1-quick: done, but 3 of 50"
    has tables/tables.md '^\| kd3 \| relidar, .quick. \| failed: .*frame 8121'
    has tables/tables.md '^\| relidar, .quick. \| 2 of 10 \|'
    for part in kd1 kd2 ws1; do check "$part was trained again" test "$(trainings "tables/$part-quick")" = 1; done
    "$relidar" "${tables[@]}" --parts kd2 "${tiny[@]}" --set train.iterations=3 >out 2>err   # of other settings than what is there
    check "exit code $?, expected 3: there is another training" test $? = 3
    has err "note: kd2-quick: missing: its training was done as .*train.iterations=2"
}

# Told to stop in the middle of a training, it goes on from the checkpoint.
interrupted() {
    local long=(tables paper --waymo waymo --out told --parts ws1 "${tiny[@]}" --set train.iterations=400 --set train.log_every=1)
    "$relidar" "${long[@]}" >out 2>err &
    for _ in $(seq 300); do
        ! grep -Eq '^iteration [0-9]+/400' told/ws1-quick/batch.log 2>/dev/null || break
        sleep 0.1
    done
    kill -TERM $!
    wait $!
    check "told to stop: exit code $?, expected 130" test $? = 130
    has told/tables.md '^\| ws1 \| relidar, .quick. \| preempted '
    "$relidar" "${long[@]}" >out 2>err
    check "went on: exit code $?, expected 3: frames are missing" test $? = 3
    has told/ws1-quick/batch.log "^resume  from iteration [1-9]"
    has told/tables.md '^\| relidar, .quick. \| 1 of 8 \| [0-9]'
    has told/tables.md '^\| ws1 \| relidar, .quick. \| done, but 11 of 50 frames were there, 1 of 4 to be held out \| 1 \|'
}

wrong
"$relidar" devices >out 2>err || { skipped=1; [[ ${RELIDAR_REQUIRE_GPU:-} != 1 ]] || fail "no Vulkan device"; }
if [[ -z ${skipped:-} ]]; then
    first_time
    goes_on
    interrupted
fi
finish_checks
