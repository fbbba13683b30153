#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <span>
#include <string>
#include <utility>
#include <vector>

// A target is a source with SPLATBUS_FUZZ_TARGET(name, input) { ... }: under libFuzzer a program of its own, and in
// every build a case of the replay test, which runs the corpus and fixed mutations of it.
namespace splatbus::fuzz {

using Bytes = std::span<const std::uint8_t>;

struct Target {
  std::string name;
  void (*run)(Bytes);
};
/// Of this program.
inline std::vector<Target>& targets() {
  static std::vector<Target> all;
  return all;
}

/// What no input may bring about: ends the process, for libFuzzer and for a test alike.
inline void require(bool condition, const char* what) {
  if (condition) return;
  std::fprintf(stderr, "not so: %s\n", what);
  std::abort();
}

/// Takes an input apart; 0 where it has ended.
class Input {
 public:
  explicit Input(Bytes bytes) : bytes_(bytes) {}

  template <class T = std::uint8_t>
  T number() {
    T value{};
    const Bytes part = take(sizeof(T));
    if (!part.empty()) std::memcpy(&value, part.data(), part.size());
    return value;
  }
  /// As many as there are, `count` at most.
  Bytes take(std::size_t count) {
    const Bytes part = bytes_.first(std::min(count, bytes_.size()));
    bytes_ = bytes_.subspan(part.size());
    return part;
  }
  Bytes rest() { return std::exchange(bytes_, {}); }
  [[nodiscard]] bool empty() const { return bytes_.empty(); }

 private:
  Bytes bytes_;
};

}  // namespace splatbus::fuzz

#ifdef SPLATBUS_LIBFUZZER
#define SPLATBUS_FUZZ_TARGET(name, input)                                             \
  static void run_##name(splatbus::fuzz::Bytes);                                      \
  extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) { \
    run_##name({data, size});                                                         \
    return 0;                                                                         \
  }                                                                                   \
  static void run_##name(splatbus::fuzz::Bytes input)
#else
#define SPLATBUS_FUZZ_TARGET(name, input)                     \
  static void run_##name(splatbus::fuzz::Bytes);              \
  static const bool registered_##name = [] {                  \
    splatbus::fuzz::targets().push_back({#name, run_##name}); \
    return true;                                              \
  }();                                                        \
  static void run_##name(splatbus::fuzz::Bytes input)
#endif
