#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
#
# relidar batch on tiny synthetic streets: what is wrong with a manifest is told before the first job; a broken log ends one job alone;
# whatever ends a batch, the same command goes on; many processes do each job once; the files for engines that docs/fleet.md offers.
#
#   batch_test.sh RELIDAR [WORK_FOLDER]
#
# Exits 77 (skipped) where there is no Vulkan device, or fails there with RELIDAR_REQUIRE_GPU=1.
set -uo pipefail
relidar=$(realpath "${1:?usage: batch_test.sh RELIDAR [WORK_FOLDER]}")
tests=$(realpath "$(dirname "${BASH_SOURCE[0]}")")
fleet=$(realpath "$tests/../../tools/examples/fleet")
work=${2:-$(mktemp -d)}
rm -rf "$work" && mkdir -p "$work" && work=$(realpath "$work") && cd "$work" || exit 1
source "$tests/checks.sh"
unset SLURM_ARRAY_TASK_ID JOB_COMPLETION_INDEX   # of the engine that may run this

# What a job's state says: number or text of a key.
told() { sed -n "s/^ \"$2\": \"\?\([^\"]*[^\",]\)\"\?,\?\$/\1/p" "$1/job.json" 2>/dev/null; }
is() { check "$1: $2 is '$(told "$1" "$2")', expected '$3'" test "$(told "$1" "$2")" = "$3"; }
trainings() { grep -c '^\$ relidar train' "$1/batch.log"; }

# wait_for FILE PATTERN: until a file holds a line that matches; a minute at most.
wait_for() {
    for _ in $(seq 600); do
        ! grep -Eq -- "$2" "$1" 2>/dev/null || return 0
        sleep 0.1
    done
    fail "$1: no line matches '$2'"
}

# Settings that train on these streets within a second; eight rows are too few to place a scan by.
defaults='[defaults]
preset = "quick"
[defaults.settings]
train = { pose_register = false, iterations = 2, log_every = 1 }
refine.enabled = false
init = { actor_min_points = 10, unlabelled_movers = "removed" }
dataset.test_every = 5
'

# manifest NAME TEXT: with the settings above.
manifest() { printf '%s%s\n' "$defaults" "$2" >"$1"; }

streets() {
    mkdir -p logs/a_sync logs/b_sync logs/broken
    printf 'seed = 5\nn_frames = 6\nrows = 8\ncolumns = 96\n' | tee logs/a_sync/street.toml >logs/b_sync/street.toml
    printf 'n_frames = "x"\n' >logs/broken/street.toml
}

# wrong CODE PATTERN TEXT: the manifest is refused with this code and line, and nothing is begun.
wrong() {
    printf '%s\n' "$3" >wrong.toml
    bad "$1" "$2" batch wrong.toml --out x
    absent x
}

wrong_manifests() {
    local a='[[job]]
log = "logs/a_sync"
name = "a"'
    bad 3 "missing.toml: no file that can be read" batch missing.toml --out x
    bad 3 "logs: no file that can be read" batch logs --out x
    bad 2 "out is required" batch wrong.toml
    wrong 3 "wrong.toml:1: not valid TOML" '[[job]'
    wrong 2 "wrong.toml: found no job, expected \[\[job\]\] entries" ''
    wrong 2 "wrong.toml: key jobs: unknown, did you mean job\?" '[[jobs]]'
    wrong 2 "wrong.toml:1: job a: key frame: unknown, did you mean frames\?" "$a
frame = \"0:5\""
    wrong 2 "wrong.toml:1: \[defaults\]: key log: unknown \(known: config, frames, out" '[defaults]
log = "x"'
    wrong 2 "job a: key preset: found a TOML integer, expected a text in quotes" "$a
preset = 5"
    wrong 2 "wrong.toml:1: \[\[job\]\]: found no log, expected key log or logs" '[[job]]'
    wrong 2 "keys log and logs: found both" "$a
logs = []"
    wrong 2 'key logs: nothing matches "logs/\*_async"' '[[job]]
logs = ["logs/*_async"]'
    wrong 2 'name: found "../a", expected at most 100 letters' '[[job]]
log = "logs/a_sync"
name = "../a"'
    wrong 2 "wrong.toml:4: job a: the name is that of the job at wrong.toml:1: job a too" "$a
$a"
    wrong 2 "job b: its folder $work/run/ is that of job a too, or lies in it" "$a
out = \"run\"
[[job]]
log = \"logs/b_sync\"
name = \"b\"
out = \"run\""
    wrong 2 "job b_sync: its folder $work/x/a/run/b_sync/ is that of job a too" "$a
[[job]]
logs = [\"logs/b_sync\"]
out = \"x/a/run/{name}\""
    wrong 2 "job a: setting train.iteration: unknown key, did you mean train.iterations\?" "$a
settings.train.iteration = 5"
    wrong 2 "job a: settings.preset: expected preset as a key of the job itself" "$a
settings.preset = \"quick\""
    wrong 2 "job a: preset 'quik': unknown, did you mean 'quick'" "$a
preset = \"quik\""
    wrong 3 "job a: none.toml: no such file" "$a
config = \"none.toml\""
    wrong 2 "job a: --frames: found \"5\", expected first:end" "$a
frames = \"5\""
    wrong 2 "job a: dataset.sequence: found 'kd1' for a synthetic street" "$a
sequence = \"kd1\""
    wrong 3 "job a: logs/c_sync: no such folder" "${a/a_sync/c_sync}"
    wrong 2 "job a: dataset kind 'kity': unknown" "${a/logs/kity:logs}"
    wrong 2 'job a: step "rendr": found command "rendr", did you mean render\?' "$a
steps = [\"rendr\"]"
    wrong 2 'job a: step "render \{rnu\}": found \{rnu\}, expected \{run\}, \{job\}, \{name\}' "$a
steps = [\"render {rnu}\"]"
    wrong 2 "job a: render .*: option --sensr: unknown, did you mean --sensor\?" "$a
steps = [\"render {run} --out {job}/s --sensr VLP-16\"]"
    wrong 2 "job a: --out: found scans, expected a place in \{job\} or \{run\}" "$a
steps = [\"render {run} --out scans\"]"
    mkdir -p full/a && touch full/a/mine
    printf '%s\n' "$a" >wrong.toml
    bad 2 "job a: $work/full/a: found mine in it, but no job of a batch" batch wrong.toml --out full
    printf '%s\n' "${a/a_sync/c_sync}" "$a" >wrong.toml   # two faults: a line each, and one that counts them
    "$relidar" batch wrong.toml --out x >out 2>err
    check "a manifest with two faults: exit code $?, expected 2" test $? = 2
    check "other than a line for each of two faults, and one that counts them" test "$(grep -c "job a: " err) $(tail -1 err)" = \
        "2 relidar: wrong.toml: 2 faults, see above; no job was begun"
    absent x
}

wrong_shares() {
    manifest two.toml '[[job]]
logs = ["logs/*_sync"]'
    bad 2 "task: found no --tasks beside it" batch two.toml --out x --task 0
    bad 2 "task: found 2, expected 0 to 1" batch two.toml --out x --task 2 --tasks 2
    bad 2 "tasks: found 0, expected 1 or more" batch two.toml --out x --task 0 --tasks 0
    bad 2 "tasks: found no --task, SLURM_ARRAY_TASK_ID or JOB_COMPLETION_INDEX" batch two.toml --out x --tasks 2
    JOB_COMPLETION_INDEX=1 bad 2 "JOB_COMPLETION_INDEX: found 1, but not of how many; expected --tasks" batch two.toml --out x
    JOB_COMPLETION_INDEX=y bad 2 'JOB_COMPLETION_INDEX: found "y", expected a number' batch two.toml --out x --tasks 2
    SLURM_ARRAY_TASK_ID=7 SLURM_ARRAY_TASK_COUNT=3 SLURM_ARRAY_TASK_MIN=1 SLURM_ARRAY_TASK_MAX=7 \
        bad 2 "found 7 of 3 tasks from 1 to 7, expected an array without gaps" batch two.toml --out x
    absent x
}

# The files of tools/examples/fleet: a manifest that relidar reads, a script that does what it says of exit codes, YAML of the right form.
engine_files() {
    mkdir -p example/logs/{street,05_sync,09_sync,KITTI-360} bin && cp "$fleet/fleet.toml" example/
    good batch example/fleet.toml --out example/fleet --status
    for job in junction 05_sync 09_sync kd-kd1 kd-kd2; do says "^$job +waiting +0/[23] "; done
    absent example/fleet
    check "slurm.sbatch is no bash" bash -n "$fleet/slurm.sbatch"
    printf '#!/bin/sh\necho "$@" >srun.txt\nexit $CODE\n' >bin/srun
    printf '#!/bin/sh\necho "$@" >>requeued.txt\n' >bin/scontrol
    chmod 755 bin/*
    for code in 0 3 4 130; do
        CODE=$code SLURM_JOB_ID=job$code PATH="$PWD/bin:$PATH" bash "$fleet/slurm.sbatch" m.toml dir --quiet >out 2>err
        check "slurm.sbatch does not end with the code of relidar" test $? = $code
    done
    check "slurm.sbatch calls other than relidar batch" grep -qx "relidar batch m.toml --out dir --quiet" srun.txt
    check "slurm.sbatch requeues other jobs than the interrupted one" test "$(cat requeued.txt)" = "requeue job130"
    local python
    for python in python3 /usr/bin/python3 none; do "$python" -c 'import yaml' 2>/dev/null && break; done
    if [[ $python == none ]]; then
        echo "note: no python3-yaml, kubernetes.yaml is not read"
    else
        "$python" "$tests/kubernetes_job.py" "$fleet/kubernetes.yaml" >err 2>&1
        check "kubernetes.yaml is not what Kubernetes and relidar expect" test $? = 0
    fi
}

# A broken log ends one job alone; steps follow training; the same again does nothing, or tries again what failed.
broken_log() {
    manifest fleet.toml '[[job]]
log = "logs/broken"
[[job]]
name = "fine"
log = "logs/a_sync"
steps = ["eval {run} --out {job}/scores.json", "render {run} --out {job}/scans --format bin"]'
    "$relidar" batch fleet.toml --out fleet >out 2>err
    check "a batch with a broken log: exit code $?, expected 3" test $? = 3
    says "^failed +broken: $work/logs/broken/street.toml line 1: n_frames"
    says "^broken +failed +0/1 +1 "
    says "^fine +done +3/3 +1 "
    says "^failed  broken: exit code 3: $work/logs/broken/street.toml"
    says "^2 jobs, 1 done, 1 failed, 0:[0-9]+ of work$"
    says "^strict/depth_medae_m +[0-9.e-]+ +1$"
    check "the batch does not end with one line" test "$(grep -c '^relidar: ' err)" = 1
    for file in run/report.html scores.json scans/scans.json; do exists fleet/fine/$file; done
    for key in '"done": 1,' '"failed": 1,' '"relidar": "[0-9]' '"strict/depth_rmse_m": ' '"message": ".*/logs/broken/street.toml line 1: n_frames'; do
        check "batch.json lacks $key" grep -q "$key" fleet/batch.json
    done
    cp fleet/fine/batch.log before
    bad 3 "1 of 2 jobs failed, job broken: .*n_frames.*--retry-failed tries again" batch fleet.toml --out fleet --quiet
    check "what failed is tried again unasked, or what is done once more" test "$(told fleet/broken attempts)$(told fleet/fine attempts)" = 11
    cp logs/a_sync/street.toml logs/broken/
    good batch fleet.toml --out fleet --retry-failed --quiet
    check "--quiet prints" test ! -s out -a ! -s err
    is fleet/broken state done
    is fleet/broken attempts 2
    check "a finished job is done again" cmp -s before fleet/fine/batch.log
    sed -i 's/^steps.*/steps = ["eval {run} --out {job}\/scores.json", "export {run} --out {job}\/way.csv"]/' fleet.toml
    good batch fleet.toml --out fleet --status
    says "^fine +waiting +2/3 +1 "
    good batch fleet.toml --out fleet
    exists fleet/fine/way.csv
    check "another step does everything again" test "$(grep -c '^\$ relidar' fleet/fine/batch.log)" = 4
    sed -i 's/iterations = 2/iterations = 3/' fleet.toml
    "$relidar" batch fleet.toml --out fleet >out 2>err
    check "other settings of a finished training: exit code $?, expected 2" test $? = 2
    check "other settings of a finished training are not told" grep -q 'job fine: its training was done as ".*iterations=2' err
    printf '{}' >fleet/fine/job.json
    bad 3 "fleet/fine/job.json: not the state of a job" batch fleet.toml --out fleet --status
}

# long_batch OUT: begins a batch whose first job trains on and on, in a group of its own like that of a terminal; waits until it does.
long_batch() {
    manifest long.toml '[[job]]
name = "long"
log = "logs/a_sync"
settings.train = { iterations = 20000, checkpoint_every = 5, checkpoint_minutes = 0.0 }
[[job]]
name = "short"
log = "logs/b_sync"'
    setsid "$relidar" batch long.toml --out "$1" >batch.out 2>batch.err &
    batch=$!
    wait_for "$1/long/run/log.jsonl" '"iteration":12,'
}

# The training ends soon where the log of the run says that it has come far enough.
shorten() { sed -i 's/iterations = 20000/iterations = '"$(($(tail -1 "$1/long/run/log.jsonl" | grep -o '"iteration":[0-9]*' | cut -d: -f2) + 40))"'/' long.toml; }

# went_on OUT: the job was resumed from a checkpoint, each of its iterations is there once, and the other job was done once.
went_on() {
    is "$1/long" state done
    is "$1/long" attempts 2
    check "$1: the training was not resumed" test "$(grep -c '^resume  from iteration [1-9]' "$1/long/batch.log")" = 1
    check "$1: the iterations are not each there once" test "$(grep -o '"iteration":[0-9]*' "$1/long/run/log.jsonl" | sort | uniq -d)" = ""
    is "$1/short" attempts 1
    is "$1/short" state done
}

interrupted() {
    long_batch told
    kill -TERM -- -$batch   # all of the group, as a terminal and Slurm do it; relidar tells the training once more
    wait $batch
    local code=$?
    check "interrupted batch: exit code $code, expected 130" test $code = 130
    check "interrupted batch does not say how to go on" grep -q "^relidar: interrupted: 0 of 2 jobs are done, 0 failed; the same command goes on" batch.err
    is told/long state preempted
    is told/long exit_code 130
    is told/short state ""
    shorten told
    good batch long.toml --out told
    went_on told
}

# A step that trains the network goes on, too.
network() {
    manifest network.toml '[[job]]
log = "logs/a_sync"
steps = ["refine {run} --no-eval --set refine.epochs=1000"]'
    setsid "$relidar" batch network.toml --out network >batch.out 2>batch.err &
    batch=$!
    wait_for network/a_sync/batch.log "epoch [0-9]+/1000 "
    kill -TERM -- -$batch
    wait $batch
    local code=$?
    check "batch interrupted while it trains a network: exit code $code, expected 130" test $code = 130
    good batch network.toml --out network
    is network/a_sync state done
    check "the network was not resumed" test "$(grep -c '^resume  from step [1-9]' network/a_sync/batch.log)" = 1
    check "the training before it was done again" test "$(trainings network/a_sync)" = 1
}

# Killed at once, the training that it leaves behind is told by the system, saves itself and ends; the next batch waits for that, however
# long it takes.
killed() {
    long_batch killed
    local training
    training=$(pgrep -P $batch)
    kill -STOP $training
    kill -KILL $batch
    wait $batch 2>/dev/null
    shorten killed
    "$relidar" batch long.toml --out killed >out 2>err &
    local next=$!
    wait_for killed/short/job.json '"state": "done"'
    is killed/long attempts 1
    kill -CONT $training
    wait $next
    check "a batch after one that was killed: exit code $?, expected 0" test $? = 0
    went_on killed
    long_batch lost
    kill -KILL -- -$batch
    wait $batch 2>/dev/null
    sleep 0.5
    good batch long.toml --out lost --status
    says "^long +lost +0/1 +1 "
    says "^2 jobs, 1 lost, 1 waiting, "
    shorten lost
    good batch long.toml --out lost
    went_on lost
}

# Two processes at the same jobs, then the tasks of an array: each job is done once. Logs that cannot be read are jobs, too, and short ones.
shared() {
    local jobs='[[job]]
log = "logs/a_sync"
'
    for i in 1 2 3 4 5 6; do jobs+="[[job]]
name = \"bad$i\"
log = \"logs/unreadable\"
"; done
    mkdir -p logs/unreadable && printf 'n_frames = "x"\n' >logs/unreadable/street.toml
    manifest shared.toml "$jobs"
    "$relidar" batch shared.toml --out both --quiet >out 2>err &
    local first=$!
    "$relidar" batch shared.toml --out both --quiet >out2 2>err2
    check "the second of two processes: exit code $?, expected 3" test $? = 3
    wait $first
    check "the first of two processes: exit code $?, expected 3" test $? = 3
    each_once both 1
    check "the last summary has not seen all jobs" grep -q '"failed": 6,' both/batch.json
    local shares=()
    for task in 5 6 7; do
        SLURM_ARRAY_TASK_ID=$task SLURM_ARRAY_TASK_COUNT=3 SLURM_ARRAY_TASK_MIN=5 SLURM_ARRAY_TASK_MAX=7 \
            "$relidar" batch shared.toml --out array >out 2>err
        shares+=("$(grep -c '^begins' out)")
    done
    check "seven jobs are dealt to three tasks as ${shares[*]}" test "${shares[*]}" = "3 2 2"
    each_once array 1
    for task in 0 1; do JOB_COMPLETION_INDEX=$task "$relidar" batch shared.toml --out array --tasks 2 --retry-failed --quiet >out 2>err; done
    each_once array 2
    good batch shared.toml --out none --task 7 --tasks 8
    says "^0 jobs, 0:00 of work$"
    exists none/batch.json
    bad 3 "/proc/relidar" batch shared.toml --out /proc/relidar
}

# each_once OUT ATTEMPTS: of the jobs that fail; the good one is done at the first.
each_once() {
    is "$1/a_sync" attempts 1
    for i in 1 2 3 4 5 6; do
        is "$1/bad$i" attempts "$2"
        check "$1/bad$i was begun $(trainings "$1/bad$i") times" test "$(trainings "$1/bad$i")" = "$2"
    done
}

streets
wrong_manifests
wrong_shares
engine_files
if "$relidar" devices >out 2>err; then
    broken_log
    interrupted
    network
    killed
    shared
elif [[ ${RELIDAR_REQUIRE_GPU:-0} == 1 ]]; then
    fail "no Vulkan device, and RELIDAR_REQUIRE_GPU=1"
else
    skipped=1
fi
finish_checks
