#!/usr/bin/env bash
# installed_test.sh BUILD SOURCE: makes Debian packages of a build, installs them, uses what is there, and purges it. For a
# Debian that is bare there is bare_root.sh.
set -euo pipefail
build="$1" source="$2" work="$(mktemp -d)" children=()
trap 'kill "${children[@]}" 2>/dev/null || true; wait; rm -rf "$work"' EXIT
fail() { echo "FAILED: $*" >&2; exit 1; }
(cd "$build" && cpack -G DEB --config CPackConfig.cmake -D CPACK_DEBIAN_COMPRESSION_TYPE=none -B "$work/debs") \
  >"$work/log" 2>&1 || { cat "$work/log" >&2; fail cpack; }
# A Debian of its own, in which nothing else is installed: what the packages depend on is this machine's.
root="$work/root"
mkdir -p "$root"/var/lib/dpkg/{info,updates,triggers} "$root/etc"
touch "$root"/var/lib/dpkg/{status,available}
in_root=(dpkg --root="$root" --force-depends --force-script-chrootless --no-triggers --path-include="*")
if [ "$EUID" -eq 0 ]; then
  "${in_root[@]}" -i "$work"/debs/*.deb >"$work/log" 2>&1 || { cat "$work/log" >&2; fail "dpkg -i"; }
else  # files can be unpacked by anybody, and be nobody's
  for deb in "$work"/debs/*.deb; do dpkg-deb -x "$deb" "$root"; done
fi
packages="$(for deb in "$work"/debs/*.deb; do dpkg-deb -f "$deb" Package; done)"
# Some are there under another name.
here="$(dpkg-query -W -f '${db:Status-Status}, ${Package}, ${Provides}\n' | sed -n 's/^installed, //p' | tr ',' '\n' | sed 's/^ *//; s/[ (:].*//')"
for package in $(for deb in "$work"/debs/*.deb; do dpkg-deb -f "$deb" Depends; done | tr ',' '\n' | sed 's/[|(].*//'); do
  grep -qx "$package" <<<"$packages" || grep -qx "$package" <<<"$here" || fail "it depends on $package, without which it was built"
done
PATH="$root/usr/bin:$PATH"

exported="$(nm -D --defined-only "$root/usr/lib/libsplatbus-engine.so.1" | awk '{print $3}')"
[ -n "$exported" ] && ! grep -qv '^splatbus_engine_' <<<"$exported" || fail "it exports: $exported"

[ "$(wc -l <"$source/examples/engine_c/engine_c.c")" -lt 100 ] || fail "the example has 100 lines or more"
export PKG_CONFIG_PATH="$root/usr/lib/pkgconfig" LD_LIBRARY_PATH="$root/usr/lib"
read -ra flags < <(pkg-config --cflags --libs splatbus-engine)
cc -Wall -Wextra -Werror -o "$work/by_pkg_config" "$source/examples/engine_c/engine_c.c" "${flags[@]}" -lm
cmake -S "$source/examples/engine_c" -B "$work/example" -DCMAKE_PREFIX_PATH="$root/usr" >/dev/null
cmake --build "$work/example" >/dev/null

mkdir -m 700 "$work/bus"
export SPLATBUS_BUS="ipc://$work/bus"
splatbus-bus 2>"$work/bus.log" & children+=($!)
splatbus-capture-bridge 2>"$work/bridge.log" & children+=($!)
for engine in "$work/by_pkg_config" "$work/example/engine_c"; do
  "$engine" --name "$(basename "$engine")" & children+=($!)
  timeout 60 splatbus topic echo engine/frame -n 1 >"$work/frame" || fail "no frame of $engine"
  grep -q "\"source\": \"$(basename "$engine")\"" "$work/frame" || fail "a frame of another than $engine: $(cat "$work/frame")"
  kill "${children[-1]}"; wait "${children[-1]}" || true
done

# complete WORD...: what bash offers for the last.
complete_line() {
  bash -c 'source "$0"; COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); _splatbus; echo "${COMPREPLY[@]}"' \
    "$root/usr/share/bash-completion/completions/splatbus" "$@"
}
expect() { [ "$1" = "$2" ] || fail "expected '$1', bash offers '$2'"; }
expect "cpu cuda" "$(complete_line splatbus launch --backend c)"
expect "sh_degree=" "$(complete_line splatbus-trainer --set sh_)"
expect "trainer.sh_degree=" "$(complete_line splatbus launch --set trainer.sh_)"
for verb in $(splatbus --help | sed -n '/^Subcommands:/,$s/^  \([a-z][a-z-]*\) .*/\1/p'); do
  [[ " $(complete_line splatbus "") " == *" $verb "* ]] || fail "bash does not offer $verb"
done
! command -v zsh >/dev/null || zsh -n "$root/usr/share/zsh/vendor-completions/_splatbus"
if command -v fish >/dev/null; then
  offers="$(fish -c "source $root/usr/share/fish/vendor_completions.d/splatbus.fish; complete -C 'splatbus topic '")"
  grep -q ^echo <<<"$offers" || fail "fish does not offer echo: $offers"
fi
! command -v mandoc >/dev/null || mandoc -Tlint -W warning "$root/usr/share/man/man1/splatbus.1.gz" || fail "the manual page"

kill "${children[@]}" 2>/dev/null || true
wait
[ "$EUID" -eq 0 ] || exit 0
"${in_root[@]}" -P $packages >"$work/log" 2>&1 || { cat "$work/log" >&2; fail "dpkg -P"; }
left="$(find "$root" -not -type d -not -path "$root/var/lib/dpkg/*")"
[ -z "$left" ] || fail "left behind: $left"
