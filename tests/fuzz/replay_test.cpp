// Every fuzz target over its committed corpus, and over changes of it that are the same in every run: --mutations N of
// them, --seconds N at most for each target, --seed N. For changes that look for new ways through the code there is
// libFuzzer: ./splatbus fuzz.
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>

#include "mutate.h"
#include "targets/target.h"

namespace splatbus::fuzz {
namespace {

long mutations = 2000;
/// A machine that is slower makes fewer.
std::chrono::seconds limit(4);
unsigned seed = 7;

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
  std::mt19937_64 random(seed);
  const auto end = std::chrono::steady_clock::now() + limit;
  long made = 0;
  for (; made < mutations && std::chrono::steady_clock::now() < end; ++made) {
    call(mutate(corpus[random() % corpus.size()], random));
  }
  std::printf("%ld changes of %zu inputs, seed %u\n", made, corpus.size(), seed);
}

std::vector<Target> in_order() {
  std::ranges::sort(targets(), {}, &Target::name);
  return targets();
}

INSTANTIATE_TEST_SUITE_P(Targets, Replay, testing::ValuesIn(in_order()),
                         [](const auto& target) { return target.param.name; });

}  // namespace
}  // namespace splatbus::fuzz

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  for (int i = 1; i + 1 < argc; i += 2) {
    const std::string option = argv[i];
    const long value = std::atol(argv[i + 1]);
    if (option == "--mutations") splatbus::fuzz::mutations = value;
    if (option == "--seconds") splatbus::fuzz::limit = std::chrono::seconds(value);
    if (option == "--seed") splatbus::fuzz::seed = static_cast<unsigned>(value);
  }
  return RUN_ALL_TESTS();
}
