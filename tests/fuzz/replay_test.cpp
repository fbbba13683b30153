// Every fuzz target over its committed corpus, and over changes of it that are the same in every run. For more of them
// there is libFuzzer: ./splatbus fuzz.
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <iterator>

#include "mutate.h"
#include "targets/target.h"

namespace splatbus::fuzz {
namespace {

constexpr int kMutations = 2000;
/// A machine that is slower makes fewer.
constexpr std::chrono::seconds kLimit(4);

std::vector<std::string> corpus_of(const std::string& target) {
  std::vector<std::filesystem::path> paths;
  for (const auto& entry : std::filesystem::directory_iterator(SPLATBUS_SOURCE_DIR "/tests/fuzz/corpus/" + target)) {
    paths.push_back(entry.path());
  }
  std::ranges::sort(paths);
  std::vector<std::string> inputs;
  for (const auto& path : paths) {
    std::ifstream file(path, std::ios::binary);
    inputs.emplace_back(std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>());
  }
  return inputs;
}

class Replay : public testing::TestWithParam<Target> {};

TEST_P(Replay, CorpusAndChangesOfItDoNoHarm) {
  const auto& [name, run] = GetParam();
  const auto call = [run = run](const std::string& input) {
    run({reinterpret_cast<const std::uint8_t*>(input.data()), input.size()});
  };
  const std::vector<std::string> corpus = corpus_of(name);
  ASSERT_FALSE(corpus.empty());
  call("");
  for (const std::string& input : corpus) call(input);
  std::mt19937_64 random(7);
  const auto end = std::chrono::steady_clock::now() + kLimit;
  for (int i = 0; i < kMutations && std::chrono::steady_clock::now() < end; ++i) {
    call(mutate(corpus[random() % corpus.size()], random));
  }
}

std::vector<Target> in_order() {
  std::ranges::sort(targets(), {}, &Target::name);
  return targets();
}

INSTANTIATE_TEST_SUITE_P(Targets, Replay, testing::ValuesIn(in_order()),
                         [](const auto& target) { return target.param.name; });

}  // namespace
}  // namespace splatbus::fuzz
