#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
#
# Packs a finished build with tools/dev/bundle, as an archive and as a wheel, and uses
# both. readelf, which tools/dev/bundle does not use, shows the versions that they need.
#
#   bundle_test.sh BUILD_FOLDER WORK_FOLDER PYTHON
#
# Exits 77 (skipped) if patchelf, or pip and wheel, are missing.
set -euo pipefail
build=$(realpath "${1:?usage: bundle_test.sh BUILD_FOLDER WORK_FOLDER PYTHON}")
work=${2:?usage: bundle_test.sh BUILD_FOLDER WORK_FOLDER PYTHON}
python=${3:?usage: bundle_test.sh BUILD_FOLDER WORK_FOLDER PYTHON}
root=$(realpath "$(dirname "${BASH_SOURCE[0]}")/../..")
rm -rf "$work" && mkdir -p "$work" && cd "$work"
export LC_ALL=C RELIDAR_BUILD=$build

fail() { printf 'bundle_test: %s\n' "$*" >&2; exit 1; }
for program in patchelf objdump readelf; do
    command -v "$program" >/dev/null || { echo "bundle_test: no $program"; exit 77; }
done

# Prints the versions of a library that files need. Arguments: prefix, files.
needed_versions() {
    local prefix=$1
    shift
    readelf -V "$@" | sed -n "s/^ *0x[0-9a-f]*: *Name: ${prefix}_\([0-9.]*\) .*Flags:.*/\1/p" | sort -uV
}
newest() { needed_versions "$@" | tail -n 1; }
# is_at_most A B: compares versions.
is_at_most() { [[ $(printf '%s\n' "$1" "$2" | sort -V | tail -n 1) == "$2" ]]; }

# The documents promise these versions for builds on Debian 12. A newer compiler needs
# newer libraries.
if grep -q '^VERSION_CODENAME=bookworm$' /etc/os-release; then
    is_at_most "$(newest GLIBC "$build/tools/relidar/relidar")" 2.35 || fail "the program needs C library $(newest GLIBC "$build/tools/relidar/relidar"), expected 2.35 or older"
    is_at_most "$(newest GLIBCXX "$build/tools/relidar/relidar")" 3.4.30 || fail "the program needs GLIBCXX $(newest GLIBCXX "$build/tools/relidar/relidar"), expected 3.4.30 or older"
fi

# The archive: its C library must provide every version that the other files need.
RELIDAR_GZIP=1 "$root/tools/dev/bundle" "$PWD/bundle.tar.gz" >bundle.log || fail "no archive: $(cat bundle.log)"
tar xzf bundle.tar.gz
defined=$(readelf -V relidar/lib/system/libc.so.6 | sed -n 's/.*Name: GLIBC_\([0-9.]*\)$/\1/p' | sort -uV)
missing=$(comm -13 <(sort <<<"$defined") <(needed_versions GLIBC relidar/libexec/relidar relidar/lib/*.so* | sort))
[[ -n $defined && -z $missing ]] || fail "the C library of the archive lacks versions: $missing; found $defined"
[[ -n $(ls relidar/licenses/libc6 relidar/licenses/libtbb12 2>/dev/null) ]] || fail "licences are missing: $(ls relidar/licenses)"
LD_TRACE_LOADED_OBJECTS=1 relidar/libexec/relidar >system.log
foreign=$(awk -v lib="$PWD/relidar/" '$2 == "=>" && index($3, lib) != 1 && $1 !~ /^(libc|libm|libdl|librt|libpthread|libresolv|libstdc[+][+]|libgcc_s)[.]so/' system.log)
[[ -z $foreign ]] || fail "libraries of the machine are used instead of those of the archive: $foreign"
version=$("$build/tools/relidar/relidar" --version)
for library in system bundle; do
    [[ $(RELIDAR_C_LIBRARY=$library relidar/bin/relidar --version) == "$version" ]] || fail "the program does not start with the C library of the $library"
    RELIDAR_C_LIBRARY=$library relidar/bin/relidar list devices >devices.log || fail "list devices failed with the C library of the $library: $(cat devices.log)"
done
LD_DEBUG=files RELIDAR_C_LIBRARY=bundle relidar/bin/relidar --version >files.log 2>&1
grep -qF "calling init: $PWD/relidar/lib/system/libc.so.6" files.log || fail "RELIDAR_C_LIBRARY=bundle did not use the C library of the archive"
! RELIDAR_C_LIBRARY=none relidar/bin/relidar --version >/dev/null 2>&1 || fail "RELIDAR_C_LIBRARY=none was accepted, expected exit code 2"

# Simulates an old machine, whose program loader lacks a library that the archive has. The
# added library exists only in the archive.
cp relidar/lib/system/libdl.so.2 relidar/lib/system/libold.so
patchelf --set-soname libold.so relidar/lib/system/libold.so
patchelf --add-needed libold.so relidar/libexec/relidar
! RELIDAR_C_LIBRARY=system relidar/bin/relidar --version >/dev/null 2>&1 || fail "the program started without libold.so"
[[ $(relidar/bin/relidar --version) == "$version" ]] || fail "the program does not start on a machine that lacks a library of the archive"
ln -s "$PWD/relidar/bin/relidar" link
[[ $(./link --version) == "$version" ]] || fail "the program does not start through a link"
# A driver can be in a folder of LD_LIBRARY_PATH.
mkdir extra && mv relidar/lib/system/libold.so extra/
[[ $(LD_LIBRARY_PATH=$PWD/extra RELIDAR_C_LIBRARY=bundle relidar/bin/relidar --version) == "$version" ]] || fail "RELIDAR_C_LIBRARY=bundle ignores LD_LIBRARY_PATH"

# The wheel: its name must promise exactly what its files need.
for module in pip wheel setuptools numpy; do
    "$python" -c "import $module" 2>/dev/null || { echo "bundle_test: no Python module $module"; exit 77; }
done
"$root/tools/dev/bundle" --wheel "$PWD/wheels" >wheel.log 2>&1 || fail "no wheel: $(cat wheel.log)"
"$python" -m venv --system-site-packages --without-pip env
env/bin/python -m pip --disable-pip-version-check --quiet install --no-index --no-deps wheels/relidar-*.whl || fail "pip did not install $(ls wheels)"
module=$(env/bin/python -c 'import os, relidar; print(os.path.dirname(relidar.__file__))')
[[ $module == "$PWD"/env/* ]] || fail "the module is $module, expected it in $PWD/env"
oldest=$(newest GLIBC "$module"/_relidar.*.so "$module"/bin/relidar "$module"/lib/*)
[[ $(ls wheels) == relidar-*-manylinux_"${oldest/./_}"_"$(uname -m)".whl ]] || fail "the wheel is $(ls wheels), expected manylinux for C library $oldest"
[[ -z $(find "$module" -name 'libc.so*' -o -name 'libstdc++*' -o -name 'libvulkan*') ]] || fail "the wheel has libraries that belong to the machine"
[[ $(env/bin/relidar --version) == "$version" ]] || fail "the wheel's relidar says $(env/bin/relidar --version), expected $version"
env/bin/relidar list devices >env.log || fail "list devices of the wheel failed: $(cat env.log)"
env/bin/python -c 'import relidar; relidar.save_street("street", n_frames=2, rows=4, columns=16)'
[[ -e street ]] || fail "the module of the wheel wrote no street"
printf 'bundle_test: %s, %s\n' "$(cat bundle.log)" "$(tail -n 1 wheel.log)"
