# SPDX-License-Identifier: Apache-2.0
# Functions that tests of the command line share: they run commands and check the results.
# A test sources this file in a separate folder, with $relidar set.
n_checks=0 n_failed=0

fail() { n_failed=$((n_failed + 1)); printf 'FAILED: %s\n' "$*"; [[ ! -s err ]] || sed 's/^/    stderr: /' err; }
check() { n_checks=$((n_checks + 1)); "${@:2}" || fail "$1"; }
exists() { check "$1 is missing or empty" test -s "$1"; }
absent() { check "$1 was left behind" test ! -e "$1"; }
says() { check "stdout of the last command lacks: $1" grep -Eq -- "$1" out; }

# good ARGS...: runs the command, which must succeed.
good() {
    "$relidar" "$@" >out 2>err
    local code=$?
    check "relidar $*: exit code $code, expected 0" test "$code" = 0
}

# bad CODE PATTERN ARGS...: the command must fail with a single matching line on stderr.
bad() {
    local code=$1 pattern=$2
    shift 2
    "$relidar" "$@" >out 2>err
    local found=$?
    check "relidar $*: exit code $found, expected $code" test "$found" = "$code"
    check "relidar $*: more or less than one line on stderr" test "$(wc -l <err)" = 1
    check "relidar $*: the message lacks '$pattern'" grep -Eq -- "^relidar(-dev)?: .*$pattern" err
}

# ends CODE WHAT: waits for process $pid, which must end with this code.
ends() {
    wait "$pid"
    local code=$?
    check "$2: exit code $code, expected $1" test "$code" = "$1"
}

# Skips the test without a Vulkan device, or fails if RELIDAR_REQUIRE_GPU=1.
need_device() {
    ! "$relidar" list devices >/dev/null 2>&1 || return 0
    echo "no Vulkan device"
    [[ ${RELIDAR_REQUIRE_GPU:-0} == 1 ]] && exit 1
    exit 77
}

# Ends the test. Exits with 77 if $skipped is set.
finish_checks() {
    printf '%d checks, %d failed%s\n' "$n_checks" "$n_failed" "${skipped:+; no Vulkan device: the rest was skipped}"
    [[ $n_failed == 0 ]] || exit 1
    [[ -z ${skipped:-} ]] || exit 77
}
