#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
#
# Tests the processing of many logs: the table of scores of `relidar eval RUN RUN ...
# --table FILE`, and the files of tools/examples/fleet for make, Snakemake (if it is
# installed), Slurm and Kubernetes.
#
#   fleet_test.sh RELIDAR [WORK_FOLDER]
#
# Exits 77 (skipped) if there is no Vulkan device, or fails if RELIDAR_REQUIRE_GPU=1.
set -uo pipefail
relidar=$(realpath "${1:?usage: fleet_test.sh RELIDAR [WORK_FOLDER]}")
tests=$(realpath "$(dirname "${BASH_SOURCE[0]}")")
fleet=$(realpath "$tests/../../tools/examples/fleet")
work=${2:-$(mktemp -d)}
rm -rf "$work" && mkdir -p "$work" && work=$(realpath "$work") && cd "$work" || exit 1
source "$tests/checks.sh"
# removes environment variables that Slurm, Kubernetes or make set if they run this test
unset SLURM_ARRAY_TASK_ID JOB_COMPLETION_INDEX MAKEFLAGS

has() { check "$1 lacks: $2" grep -Fq -- "$2" "$1"; }

# run NAME FRAMES GRID METRICS: makes a folder that looks like a run with these scores.
run() {
    mkdir -p "scored/$1"
    touch "scored/$1/scene.json"
    printf '{"dataset": "logs/%s", "frames": %s, "protocol": {"grid": "%s"}, "mean": {%s}}' "$@" >"scored/$1/metrics.json"
    printf '{"iteration": 2, "seconds": 12.5}\n' >"scored/$1/log.jsonl"
}

# Scores by hand, so that the means can be computed by hand.
score_tables() {
    run a '[{}, {}]' native '"points/depth_medae_m": 0.25, "strict/drop_accuracy": 0.5, "own/metric": 7'
    run 'b|c' '[{}]' native '"points/depth_medae_m": 0.75, "strict/drop_accuracy": null'
    good eval scored/a/ 'scored/b|c' --table t.md --table t.csv --table t.html
    has t.md '| run | log | held-out frames | training s | points/depth_medae_m | strict/drop_accuracy |'
    has t.md '| scored/a | logs/a | 2 | 12.5 | 0.25 | 0.5 |'
    has t.md '| scored/b\|c | logs/b\|c | 1 | 12.5 | 0.75 | - |'
    has t.md '| mean of 2 runs |  |  |  | 0.5 | 0.5 |'
    check "equal protocols are called different" test "$(grep -c "different settings" t.md)" = 0
    has t.csv 'run,log,frames,training_s,own/metric,points/depth_medae_m,strict/drop_accuracy'
    has t.csv '"scored/a","logs/a",2,12.5,7,0.25,0.5'
    has t.csv '"scored/b|c","logs/b|c",1,12.5,,0.75,'
    for text in "scored/a" "scored/b|c" "2 of 2 runs have scores" "Typical range error"; do has t.html "$text"; done
    run d '[{}]' kitti360 '"points/depth_medae_m": 1'
    good eval scored/a scored/d --table t.md
    has t.md "Compare the runs with care, because they were scored with different settings: grid."
    bad 2 "2 runs .*--table" eval scored/a scored/d
    bad 2 "--table: .*t.txt; .*\.md, .*\.csv .*\.html" eval scored/a --table t.txt
    bad 2 "--set .*--table" eval scored/a --table t.md --set render.range=median
    bad 3 "nowhere " eval scored/a nowhere --table t.md
    mkdir scored/unscored scored/damaged
    touch scored/unscored/scene.json scored/damaged/scene.json
    printf '{"mean": ' >scored/damaged/metrics.json
    bad 3 "2 of 3 .*metrics.json, .*scored/unscored; .*eval scored/unscored" \
        eval scored/a scored/unscored scored/damaged --table t.md
    has t.md '| scored/a | logs/a | 2 | 12.5 | 0.25 | 0.5 |'
    has t.md '| scored/damaged | no scores | - | 0 | - | - |'
}

# Programs that record their arguments and exit with $CODE.
stand_ins() {
    mkdir bin
    printf '#!/bin/sh\nexec "$@"\n' >bin/srun
    printf '#!/bin/sh\necho "$@" >>requeued.txt\n' >bin/scontrol
    printf '#!/bin/sh\necho "$@" >called.txt\nexit ${CODE:-0}\n' >bin/relidar
    chmod 755 bin/*
    mkdir -p fleet/logs/a fleet/logs/b
}

slurm() {
    check "slurm.sbatch is not valid bash" bash -n "$fleet/slurm.sbatch"
    for code in 0 3 4 130; do
        CODE=$code SLURM_JOB_ID=job$code SLURM_ARRAY_TASK_ID=1 PATH="$PWD/bin:$PATH" \
            bash "$fleet/slurm.sbatch" fleet/logs runs --preset quick >out 2>err
        check "slurm.sbatch does not end with the exit code of relidar" test $? = $code
    done
    has called.txt "train fleet/logs/b --out runs/b --preset quick --quiet --resume"
    check "slurm.sbatch requeues other tasks than the interrupted one" test "$(cat requeued.txt)" = "requeue job130"
    rm called.txt
    SLURM_ARRAY_TASK_ID=2 PATH="$PWD/bin:$PATH" bash "$fleet/slurm.sbatch" fleet/logs runs >out 2>err
    check "slurm.sbatch trains a log that does not exist" test $? != 0 -a ! -e called.txt
}

kubernetes() {
    local python
    for python in python3 /usr/bin/python3 none; do "$python" -c 'import yaml' 2>/dev/null && break; done
    [[ $python != none ]] || { echo "note: no python3-yaml, kubernetes.yaml is not read"; return; }
    "$python" "$tests/kubernetes_job.py" "$fleet/kubernetes.yaml" >script 2>err
    check "kubernetes.yaml is not what Kubernetes and relidar expect" test $? = 0
    sed -i "s|/fleet|$work/fleet|g" script
    CODE=130 JOB_COMPLETION_INDEX=1 PATH="$PWD/bin:$PATH" sh -c "$(<script)" >out 2>err
    check "the container does not end with the exit code of relidar" test $? = 130
    has called.txt "train $work/fleet/logs/b --out $work/fleet/runs/b --preset default --quiet --resume"
}

# Settings that train on these streets within a second. Poses are not refined, because
# eight rows are not enough to register a scan.
train="--preset quick --set train.iterations=2 --set train.refine_poses=none --set refine.enabled=false"
train+=" --set init.actor_min_points=10 --set init.unlabelled_movers=removed --set dataset.test_every=5"

streets() {
    mkdir -p streets/logs/{a,b}
    printf 'seed = 5\nn_frames = 6\nrows = 8\ncolumns = 96\n' | tee streets/logs/a/street.toml >streets/logs/b/street.toml
}

fleet_make() { make -f "$fleet/Makefile" RELIDAR="$relidar" TRAIN="$train" "$@" >../out 2>../err; }

# A damaged log must not stop the other logs.
makefile() {
    cp -r streets make && cd make || exit 1
    fleet_make -n
    check "make -n: exit code $?, expected 0" test $? = 0
    check "make -n does not show a training for each log" test "$(grep -c "train logs/[ab] --out runs/[ab] .*--resume" ../out)" = 2
    check "make -n makes something" test "$(ls)" = logs
    mkdir logs/c && printf 'n_frames = "x"\n' >logs/c/street.toml
    fleet_make -k
    check "make with a damaged log: exit code $?, expected 2" test $? = 2
    check "make -k does not train the other logs" test -e done/a -a -e done/b -a ! -e done/c -a ! -e scores.md
    rm -r logs/c
    fleet_make
    check "make: exit code $?, expected 0" test $? = 0
    check "make trains again" test "$(grep -c train ../out)" = 0
    check "scores.md has no row for each run" test "$(grep -Ec '^\| runs/[ab] .*/logs/[ab] |mean of 2 runs' scores.md)" = 3
    exists scores.html
    rm done/a && cp runs/a/log.jsonl before
    fleet_make
    check "make fails for a run that is complete" test $? = 0
    check "a run that is complete is trained again" cmp -s before runs/a/log.jsonl
    # shellcheck disable=SC2086
    bad 2 "another .*dataset.path" train logs/b --out runs/a $train --resume
    cd ..
}

# Snakemake must do the same as make, on the runs that make has trained. tools/dev/setup
# does not install Snakemake, because Debian's package depends on 76 other packages.
snakefile() {
    command -v snakemake >/dev/null || { echo "note: no snakemake, the Snakefile is not run"; return; }
    cd make && rm -r "done" scores.* || exit 1
    for words in -n ""; do
        snakemake -s "$fleet/Snakefile" --cores 1 $words --config relidar="$relidar" train="$train" >../out 2>../err
        check "snakemake $words: exit code $?, expected 0" test $? = 0
    done
    check "scores.md has no row for each run" test "$(grep -Ec '^\| runs/[ab] .*/logs/[ab] |mean of 2 runs' scores.md)" = 3
    cd ..
}

# Two scenes with the same seed have the same files. A repeated command renders nothing, another
# seed or sensor is refused, and a scene that was interrupted is rendered again.
variations() {
    local python=/usr/bin/python3 made="../set/data"
    vary() {
        "$python" "$fleet/variations.py" runs/a --relidar "$relidar" --sensor VLP-16:90x10 --frames 0:2 \
            --layout kitti --camera none --scenes 2 "$@" >../out 2>../err
    }
    cd make || exit 1
    vary --out ../set
    check "variations.py: exit code $?, expected 0" test $? = 0
    check "variations.py renders other scans than two of each scene" \
        test "$(find "$made/training/velodyne" -name '*.bin' | wc -l)" = 4
    (cd "$made" && find . -name '*.bin' -exec sha256sum {} +) | sort >../first
    vary --out ../set
    check "variations.py renders a complete data set again" test ! -s ../out
    rm ../set/done/0001
    mkdir ../set/edited && touch ../set/edited/half
    vary --out ../set
    (cd "$made" && find . -name '*.bin' -exec sha256sum {} +) | sort >../second
    check "a scene differs after an interruption" cmp -s ../first ../second
    vary --out ../set --seed 2
    check "variations.py mixes two seeds" test $? = 1
    vary --out ../set --sensor VLP-16:90x12
    check "variations.py mixes two sensors" test $? = 1
    cd ..
}

# Copies that overlap something get other places, until no note of `edit` names them. The stand-in
# for relidar prints such a note for the first three edits with copies.
moved_copies() {
    cat >bin/relidar_notes <<'STAND_IN'
#!/bin/sh
case $1 in
info) echo '{"log": {"boxes": [{"id": "0", "class": "Car", "surfels": 5}]}}' ;;
export) printf 'x,y,yaw_deg\n0,0,0\n' >"$4" ;;
edit)
    n=0
    for word; do
        case $word in 0@*) n=$((n + 1)) && echo "copied 0 as 0-copy-$n, on the ground" ;; esac
    done
    [ $n = 0 ] || echo edit >>edits.txt
    [ $n = 0 ] || [ "$(wc -l <edits.txt)" -gt 3 ] || echo "note: the background, for example a wall, fills 9 % of the box of 0-copy-1 above"
    ;;
esac
STAND_IN
    chmod 755 bin/relidar_notes
    /usr/bin/python3 "$fleet/variations.py" r --out moved --scenes 8 --relidar "$PWD/bin/relidar_notes" >out 2>err
    check "variations.py fails with the stand-in" test $? = 0
    check "variations.py does not move the copies in notes" test "$(cat moved/done/* | grep -c '^moved: 0@')" = 3
    check "variations.py moves copies without a note" test "$(grep -L . moved/done/* | wc -l)" = 7
}

score_tables
stand_ins
slurm
kubernetes
moved_copies
if "$relidar" list devices >out 2>err; then
    streets
    makefile
    variations
    snakefile
elif [[ ${RELIDAR_REQUIRE_GPU:-0} == 1 ]]; then
    fail "no Vulkan device, and RELIDAR_REQUIRE_GPU=1"
else
    skipped=1
fi
finish_checks
