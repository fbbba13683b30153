#!/usr/bin/env bash
# installed_test.sh BUILD SOURCE: installs into a temporary prefix, and uses what is there.
set -euo pipefail
build="$1" source="$2" work="$(mktemp -d)" children=()
trap 'kill "${children[@]}" 2>/dev/null || true; wait; rm -rf "$work"' EXIT
fail() { echo "FAILED: $*" >&2; exit 1; }
cmake --install "$build" --prefix "$work/usr" >"$work/log" 2>&1 || { cat "$work/log" >&2; fail install; }
PATH="$work/usr/bin:$PATH"

exported="$(nm -D --defined-only "$work/usr/lib/libsplatbus-engine.so.1" | awk '{print $3}')"
[ -n "$exported" ] && ! grep -qv '^splatbus_engine_' <<<"$exported" || fail "it exports: $exported"

[ "$(wc -l <"$source/examples/engine_c/engine_c.c")" -lt 100 ] || fail "the example has 100 lines or more"
export PKG_CONFIG_PATH="$work/usr/lib/pkgconfig" LD_LIBRARY_PATH="$work/usr/lib"
read -ra flags < <(pkg-config --cflags --libs splatbus-engine)
cc -Wall -Wextra -Werror -o "$work/by_pkg_config" "$source/examples/engine_c/engine_c.c" "${flags[@]}" -lm
cmake -S "$source/examples/engine_c" -B "$work/example" -DCMAKE_PREFIX_PATH="$work/usr" >/dev/null
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
    "$work/usr/share/bash-completion/completions/splatbus" "$@"
}
expect() { [ "$1" = "$2" ] || fail "expected '$1', bash offers '$2'"; }
expect "cpu cuda" "$(complete_line splatbus launch --backend c)"
expect "sh_degree=" "$(complete_line splatbus-trainer --set sh_)"
expect "trainer.sh_degree=" "$(complete_line splatbus launch --set trainer.sh_)"
for verb in $(splatbus --help | sed -n '/^Subcommands:/,$s/^  \([a-z][a-z-]*\) .*/\1/p'); do
  [[ " $(complete_line splatbus "") " == *" $verb "* ]] || fail "bash does not offer $verb"
done
! command -v zsh >/dev/null || zsh -n "$work/usr/share/zsh/vendor-completions/_splatbus"
if command -v fish >/dev/null; then
  offers="$(fish -c "source $work/usr/share/fish/vendor_completions.d/splatbus.fish; complete -C 'splatbus topic '")"
  grep -q ^echo <<<"$offers" || fail "fish does not offer echo: $offers"
fi
! command -v mandoc >/dev/null || mandoc -Tlint -W warning "$work/usr/share/man/man1/splatbus.1.gz" || fail "the manual page"
