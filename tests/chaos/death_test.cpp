// Processes that die between any two stores into memory that others read, and what these find then: --kills N deaths a
// case, --seed N.
#include <gtest/gtest.h>
#include <signal.h>

#include <algorithm>
#include <random>
#include <sstream>
#include <vector>

#include "../unit/bus/child_process.h"
#include "../unit/model/kill_script.h"
#include "bus/slab.h"
#include "ring_pattern.h"

namespace splatbus::chaos {
namespace {

using model::Found;
using model::make_change;
using model::PageStore;
using model::Truth;

int kills = 4;
unsigned seed = 1;

class Death : public bus_test::BusTest {
 protected:
  /// Its exit status, or minus its signal; what it said is in said().
  int run(std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), directory_.path());
    bus_test::ChildProcess process("test-chaos-killed", arguments, directory_.path() + "/said");
    return process.wait();
  }
  [[nodiscard]] std::string said() const { return bus_test::read_text(directory_.path() + "/said"); }
  [[nodiscard]] std::uint64_t stores() const {
    const std::string text = said();
    const auto at = text.rfind("stores ");
    return at == std::string::npos ? 0 : std::stoull(text.substr(at + 7));
  }

  /// From 1 to `most`, both ends among them.
  std::vector<std::uint64_t> some_of(std::uint64_t most) {
    std::vector<std::uint64_t> chosen{1, most};
    while (chosen.size() < static_cast<std::size_t>(kills)) chosen.push_back(1 + random_() % most);
    return chosen;
  }

  std::mt19937_64 random_{seed};
};

class DeathInAChange : public Death, public testing::WithParamInterface<const char*> {
 protected:
  void drop_model(const std::shared_ptr<bus::Context>& context) {
    for (const char* role : {"page-table", "pages-0", "page-table-moved", "pages-moved-0"}) context->drop_slab(role);
  }

  static Truth truth_after(std::size_t changes) {
    Truth truth;
    for (std::size_t c = 0; c < changes; ++c) make_change(c, nullptr, truth);
    return truth;
  }

  /// All that is in either is as it was made, and what is found is one of the two or, of a removal, between them.
  static void expect_before_or_after(const PageStore& store, const Truth& before, const Truth& after) {
    const Found found(store);
    EXPECT_EQ(store.count(), found.by_id.size());
    for (const auto& [id, place] : found.by_id) {
      const auto was = before.gaussians.find(id), is = after.gaussians.find(id);
      ASSERT_TRUE(was != before.gaussians.end() || is != after.gaussians.end()) << "nobody made Gaussian " << id;
      ASSERT_EQ(place.gaussian, was != before.gaussians.end() ? was->second : is->second) << "Gaussian " << id;
    }
    const std::size_t least = std::min(before.gaussians.size(), after.gaussians.size());
    if (after.gaussians.size() < before.gaussians.size()) {
      for (const auto& [id, gaussian] : after.gaussians) ASSERT_TRUE(found.by_id.contains(id)) << "lost: " << id;
    } else {
      ASSERT_TRUE(found.by_id.size() == least || found.by_id.size() == after.gaussians.size()) << "half of a change";
    }
    ASSERT_GE(found.by_id.size(), least);
  }
};

TEST_P(DeathInAChange, AnotherFindsTheModelBeforeOrAfterIt) {
  // An insertion with splits, copies, a removal, a merge, a freezing.
  for (const std::size_t change : {2, 3, 4, 8, 9}) {
    ASSERT_EQ(run({"model", GetParam(), std::to_string(change), "0"}), 0) << said();
    const std::uint64_t most = stores();
    ASSERT_GT(most, 10U) << "of change " << change;
    drop_model(connect("trainer"));
    for (const std::uint64_t store : some_of(most)) {
      SCOPED_TRACE("change " + std::to_string(change) + ", store " + std::to_string(store) + " of " +
                   std::to_string(most));
      const int status = run({"model", GetParam(), std::to_string(change), std::to_string(store)});
      // How many there are differs a little from run to run.
      ASSERT_TRUE(status == -SIGKILL || (status == 0 && stores() <= store)) << status << ": " << said();
      const auto context = connect("trainer");
      {
        PageStore adopted(context, {}, {.max_gaussians = model::kScriptGaussians}, Device::Cpu);
        expect_before_or_after(adopted, truth_after(change), truth_after(change + 1));
        // And it goes on: what comes next is whole.
        Truth truth;
        for (const auto& [id, place] : Found(adopted).by_id) truth.gaussians[id] = place.gaussian;
        truth.next_id = adopted.next_gaussian_id();
        make_change(11, &adopted, truth);
        ASSERT_EQ(Found(adopted).by_id.size(), truth.gaussians.size());
      }
      if (HasFailure()) return;
      drop_model(context);
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Slabs, DeathInAChange, testing::Values("page-table", "pages-"),
                         [](const auto& slabs) { return std::string(slabs.param) == "pages-" ? "Pages" : "Table"; });

struct Written {
  std::size_t slot = 0;
  std::uint64_t generation = 0, value = 0;
};

using DeathInAWrite = Death;

TEST_F(DeathInAWrite, NoReaderTakesAHalfForAWholeAndTheNextWriterGoesOn) {
  ASSERT_EQ(run({"ring", "0"}), 0) << said();
  const std::uint64_t most = stores();
  ASSERT_EQ(most, kRingWrites * (kRingWords + 2)) << "one to begin, one a word, one to end";
  std::vector<std::uint64_t> all;
  for (std::uint64_t store = 1; store <= most; ++store) all.push_back(store);
  std::ranges::shuffle(all, random_);
  all.resize(std::min<std::size_t>(all.size(), 4 * static_cast<std::size_t>(kills)));
  for (const std::uint64_t store : all) {
    SCOPED_TRACE("store " + std::to_string(store));
    ASSERT_EQ(run({"ring", std::to_string(store)}), -SIGKILL);
    std::istringstream lines(said());
    std::string word;
    std::uint64_t id = 0;
    std::vector<Written> written;
    while (lines >> word) {
      if (word == "slab") lines >> id;
      Written one;
      if (word == "wrote" && lines >> one.slot >> one.generation >> one.value) written.push_back(one);
    }
    const auto slab = connect("reader")->open_slab(id);
    ASSERT_NE(slab, nullptr) << "it is for a successor";
    std::size_t whole = 0;
    for (const auto& [slot, generation, value] : written) {
      std::vector<std::uint64_t> words(kRingWords);
      if (!slab->copy(slab->span(slot, 0, kRingWords * sizeof(std::uint64_t), generation), words.data())) continue;
      ++whole;
      EXPECT_EQ(words, std::vector<std::uint64_t>(kRingWords, value)) << "a half";
    }
    EXPECT_GE(whole + 1, std::min(written.size(), kRingSlots)) << "what was not being written is there";
    const auto heir = connect("trainer");
    const auto adopted = heir->adopt_slab("trainer/ring");
    ASSERT_NE(adopted, nullptr);
    for (std::size_t slot = 0; slot < kRingSlots; ++slot) {
      const std::uint64_t before = adopted->sequence(slot);
      adopted->begin_write(slot);
      EXPECT_EQ(adopted->sequence(slot) % 2, 1U);
      const std::uint64_t after = adopted->end_write(slot);
      EXPECT_EQ(after % 2, 0U);
      EXPECT_GT(after, before);
    }
    heir->drop_slab("ring");
    if (HasFailure()) return;
  }
}

}  // namespace
}  // namespace splatbus::chaos

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  for (int i = 1; i + 1 < argc; i += 2) {
    if (std::string(argv[i]) == "--kills") splatbus::chaos::kills = std::max(2, std::atoi(argv[i + 1]));
    if (std::string(argv[i]) == "--seed") splatbus::chaos::seed = static_cast<unsigned>(std::atoi(argv[i + 1]));
  }
  return RUN_ALL_TESTS();
}
