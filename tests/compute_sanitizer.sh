#!/usr/bin/env bash
# compute_sanitizer.sh BUILD_DIR [PROGRAM...]: memcheck and racecheck over the test programs that use a CUDA device, by
# default all in BUILD_DIR/bin, side by side. Prints one line a check; the status is 1 when one of them did not pass.
#   JOBS=N      checks at a time (default: one a core, 12 at most)
#   LIMIT_S=N   seconds that a check may take (default 400)
#   LOGS=DIR    keeps the whole output of every check that did not pass (default: only its end is printed)
set -uo pipefail

bin="${1:?usage: compute_sanitizer.sh BUILD_DIR [PROGRAM...]}/bin"
bin="$(cd "$bin" && pwd)" || exit 2
shift
cores="$(nproc)"
jobs="${JOBS:-$((cores < 12 ? cores : 12))}"
export limit_s="${LIMIT_S:-400}" logs="${LOGS:-}"
[ -z "$logs" ] || { mkdir -p "$logs" && logs="$(cd "$logs" && pwd)"; }
sanitizer="$(PATH="$PATH:/usr/local/cuda/bin" command -v compute-sanitizer)" ||
  { echo "compute_sanitizer.sh: no compute-sanitizer on the path or in /usr/local/cuda/bin" >&2; exit 2; }
export sanitizer

# Those that take longest go first. test_bus, test_model and test_trainer use a device where there is one.
programs=("$@")
if [ ${#programs[@]} -eq 0 ]; then
  for program in model trainer_cuda raster_cuda; do
    [ -x "$bin/test_$program" ] && programs+=("test_$program")
  done
  # The operations of LibTorch use a device where LibTorch itself does.
  if ldd "$bin/test_raster_torch" 2>/dev/null | grep torch_cuda >/dev/null; then programs+=("test_raster_torch"); fi
  for program in "$bin"/test_*cuda* "$bin"/test_bus_gpu "$bin"/test_bus "$bin"/test_trainer; do
    program="$(basename "$program")"
    [ -x "$bin/$program" ] && [[ " ${programs[*]} " != *" $program "* ]] && programs+=("$program")
  done
fi
[ ${#programs[@]} -gt 0 ] || { echo "compute_sanitizer.sh: $bin holds no tests of a CUDA build" >&2; exit 2; }

check() {
  local tool="$1" program="$2" log status ran skipped summary verdict=passed processes=application-only options=()
  log="$(mktemp)"
  SECONDS=0
  # A call that the driver refuses is not an access to memory. Every status is looked at, and some tests want to see one:
  # only the driver can tell that memory is smaller than a peer says, or none of its own.
  [ "$tool" = memcheck ] && options=(--report-api-errors no)
  # Processes that a test starts are tests of their own; some of them are killed on purpose. The writers
  # that test_model kills are checked too: in one that is not, the sanitizer's library waits for ever.
  [ "$program" = test_model ] && processes=all
  timeout "$limit_s" "$sanitizer" --tool "$tool" "${options[@]}" --error-exitcode 97 \
    --target-processes "$processes" "./$program" >"$log" 2>&1
  status=$?
  ran="$(grep -c '^\[       OK' "$log")"
  skipped="$(grep -cE '^\[  SKIPPED \] .*\(' "$log")"
  summary="$(grep -oE '(ERROR|RACECHECK) SUMMARY: .*' "$log" | tail -n 1)"
  case "$status" in
    0) [ "$ran" -gt 0 ] || verdict="NOTHING RAN" ;;
    124) verdict="TIMED OUT" ;;
    97) verdict=FOUND ;;
    *) verdict="FAILED (status $status)" ;;
  esac
  printf '%-9s %-28s %s: %s tests, %s skipped, %s s; %s\n' \
    "$tool" "$program" "$verdict" "$ran" "$skipped" "$SECONDS" "${summary:-no summary}"
  if [ "$verdict" != passed ]; then
    grep -E '^\[  FAILED  \]|^=========' "$log" | grep -v SUMMARY | head -n 20 | sed 's/^/    /'
    [ -z "$logs" ] || cp "$log" "$logs/$tool.$program.txt"
  fi
  rm -f "$log"
  [ "$verdict" = passed ]
}
export -f check

cd "$bin" || exit 2
for program in "${programs[@]}"; do
  printf 'racecheck\0%s\0memcheck\0%s\0' "$program" "$program"
done | xargs -0 -n 2 -P "$jobs" bash -c 'check "$@" || exit 1' check || exit 1
