// Stores whose process is killed inside a change, and those that come after them.
#include <signal.h>

#include "../bus/child_process.h"
#include "device_test.h"
#include "kill_script.h"

namespace splatbus::model {

namespace {

class PageKillTest : public DeviceTest {
 protected:
  [[nodiscard]] std::string output() const { return directory_.path() + "/output"; }

  int run_and_kill(int change, ChangePoint point) {
    bus_test::ChildProcess killed("test-model-killed",
                                  {directory_.path(), std::to_string(static_cast<int>(GetParam())),
                                   std::to_string(change), std::to_string(static_cast<int>(point))},
                                  output());
    return killed.wait();
  }

  /// Kills at that point of that change; whoever comes next finds the model as it was before or as it is after.
  void kill_and_adopt(std::size_t change, ChangePoint point, Device next) {
    SCOPED_TRACE("change " + std::to_string(change) + ", point " + std::to_string(static_cast<int>(point)));
    const int status = run_and_kill(static_cast<int>(change), point);
    const bool removal = change == 4 || change == 6 || change == 7 || change == 10;
    if (status == 0) {
      EXPECT_TRUE(!removal && (point == ChangePoint::Opened || point == ChangePoint::Cleared))
          << "this change never came to that point";
    } else {
      ASSERT_EQ(status, -SIGKILL) << bus_test::read_text(output());
    }
    Truth truth;
    const bool lost = point < (removal ? ChangePoint::Cleared : ChangePoint::Committed);
    const std::size_t made = status == 0 ? kScriptChanges : change + (lost ? 0 : 1);
    for (std::size_t c = 0; c < made; ++c) make_change(c, nullptr, truth);
    {
      const auto context = connect("trainer");
      PageStore store(context, {}, {.max_gaussians = kScriptGaussians}, next);
      expect_holds(store, truth);
      EXPECT_EQ(store.holds(1, change),
                truth.next_id != before(change) && !removal && change != 3 && change != 8 && change != 9)
          << "remembered";
      // And it goes on from there.
      for (std::size_t c = made; c < kScriptChanges; ++c) make_change(c, &store, truth);
      expect_holds(store, truth);
      for (const char* role : {"page-table", "page-table-moved", "pages-0", "pages-moved-0"}) context->drop_slab(role);
    }
  }

  static std::uint64_t before(std::size_t change) {
    Truth truth;
    for (std::size_t c = 0; c < change; ++c) make_change(c, nullptr, truth);
    return truth.next_id;
  }

  static void expect_holds(const PageStore& store, const Truth& truth) {
    const Found found(store);
    SCOPED_TRACE(store.origin());
    expect_whole(found, truth);
    ASSERT_EQ(store.count(), truth.gaussians.size());
    ASSERT_EQ(store.next_gaussian_id(), truth.next_id);
  }
};

TEST_P(PageKillTest, WhereverAnInsertionOrAMergeIsKilledItIsWhollyThereOrNotAtAll) {
  for (const std::size_t change : {0, 1, 2, 3, 8, 11}) {
    for (const ChangePoint point :
         {ChangePoint::Copied, ChangePoint::Numbered, ChangePoint::Written, ChangePoint::Proposed,
          ChangePoint::Committed, ChangePoint::FoldedOne, ChangePoint::Folded}) {
      kill_and_adopt(change, point, GetParam());
      if (HasFatalFailure() || HasNonfatalFailure()) return;
    }
  }
}

TEST_P(PageKillTest, WhereverARemovalIsKilledNobodyElseIsLostOrThereTwice) {
  for (const std::size_t change : {4, 6, 10}) {
    for (const ChangePoint point :
         {ChangePoint::Opened, ChangePoint::Cleared, ChangePoint::Copied, ChangePoint::Numbered, ChangePoint::Proposed,
          ChangePoint::Committed, ChangePoint::FoldedOne, ChangePoint::Folded}) {
      kill_and_adopt(change, point, GetParam());
      if (HasFatalFailure() || HasNonfatalFailure()) return;
    }
  }
}

TEST_P(PageKillTest, WhereverPagesAreFrozenNobodyIsLost) {
  for (const ChangePoint point : {ChangePoint::Proposed, ChangePoint::Committed, ChangePoint::FoldedOne}) {
    kill_and_adopt(9, point, GetParam());
    if (HasFatalFailure() || HasNonfatalFailure()) return;
  }
}

TEST_P(PageKillTest, WhoeverAdoptsMayBeKilledOverItToo) {
  ASSERT_EQ(run_and_kill(4, ChangePoint::Numbered), -SIGKILL);
  for (const ChangePoint point : {ChangePoint::Opened, ChangePoint::Cleared, ChangePoint::Copied, ChangePoint::Numbered,
                                  ChangePoint::Proposed, ChangePoint::FoldedOne}) {
    ASSERT_EQ(run_and_kill(-1, point), -SIGKILL) << bus_test::read_text(output());
  }
  Truth truth;
  for (std::size_t c = 0; c < 5; ++c) make_change(c, nullptr, truth);
  expect_holds(PageStore(connect("trainer"), {}, {.max_gaussians = kScriptGaussians}, GetParam()), truth);
}

TEST_P(PageKillTest, TheNextOneMayHaveTheOtherKindOfMemory) {
  if (GetParam() == Device::Cpu) GTEST_SKIP() << "needs two kinds";
  kill_and_adopt(2, ChangePoint::Proposed, Device::Cpu);
  kill_and_adopt(2, ChangePoint::FoldedOne, Device::Cpu);
  kill_and_adopt(4, ChangePoint::Numbered, Device::Cpu);
}

INSTANTIATE_TEST_SUITE_P(Devices, PageKillTest, testing::Values(Device::Cpu, Device::Cuda), device_name);

}  // namespace

}  // namespace splatbus::model
