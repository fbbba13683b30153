#include "model/published_model.h"

#include <gmock/gmock.h>

#include "../bus/bus_fixture.h"
#include "bus/backend.h"
#include "bus/error.h"
#include "truth.h"
#include "wire/model_generated.h"
#include "wire/topics.h"

namespace splatbus::model {

namespace {

using testing::HasSubstr;

class PublishedModelTest : public bus_test::BusTest, public testing::WithParamInterface<std::tuple<Device, Device>> {
 protected:
  void SetUp() override {
    const auto [published, wanted] = GetParam();
    const bool device = published == Device::Cuda || wanted == Device::Cuda;
    if (device && bus::choose_backend("auto") != Device::Cuda) GTEST_SKIP() << "no CUDA device";
    store_ =
        std::make_unique<PageStore>(maker_, ParameterLayout{}, PageStoreOptions{.max_gaussians = 500'000}, published);
  }
  void add(std::size_t count) {
    const Batch batch = make_batch(random_, count, false, 3);
    insert(*store_, batch, ++batches_);
    truth_.insert(batch, count);
  }
  bus::Message publish() {
    store_->publish(publisher_);
    auto message = subscriber_.receive(bus_test::patience);
    if (!message) throw std::runtime_error("nothing arrived");
    return *message;
  }
  [[nodiscard]] static Device wanted() { return std::get<1>(GetParam()); }

  /// The model that a reader sees is the truth, Gaussian by Gaussian.
  void expect_truth(const PublishedModel& model) const {
    const GaussiansView& view = model.average();
    ASSERT_TRUE(view.has_pages());
    std::size_t seen = 0;
    for (const IndexRange& range : view.ranges) {
      const auto ids = to_host(wanted(), view.gaussian_id + view.wide_offset(range.first), range.count);
      std::vector<std::vector<float>> rows;
      for (int c = 0; c < view.layout.channels(); ++c) {
        rows.push_back(to_host(wanted(), view.at(c, range.first), range.count));
      }
      const auto visibility = to_host(wanted(), view.visibility + view.offset(range.first), range.count);
      for (std::uint32_t k = 0; k < range.count; ++k, ++seen) {
        const Gaussian& expected = truth_.gaussians.at(ids[k]);
        ASSERT_EQ(expected.frame_id, range.frame_id);
        for (std::size_t c = 0; c < rows.size(); ++c) ASSERT_EQ(rows[c][k], expected.values[c]) << c;
        ASSERT_EQ(visibility[k], expected.values.back());
      }
    }
    ASSERT_EQ(seen, truth_.gaussians.size());
    ASSERT_EQ(model.count(), truth_.gaussians.size());
  }

  std::shared_ptr<bus::Context> maker_ = connect("trainer"), reader_ = connect("reader");
  bus::Publisher publisher_{maker_};
  bus::Subscriber subscriber_{reader_, {"model/published"}};
  std::unique_ptr<PageStore> store_;
  std::mt19937 random_{5};
  std::uint64_t batches_ = 0;
  Truth truth_;
};

TEST_P(PublishedModelTest, IsWhatTheStoreHolds) {
  add(20'000);
  auto model = PublishedModel::open(publish(), wanted());
  ASSERT_TRUE(model);
  expect_truth(*model);
  EXPECT_EQ(model->copied_bytes() > 0, std::get<0>(GetParam()) != wanted());
  EXPECT_TRUE(model->refresh());
  EXPECT_NE(model->live().parameters, nullptr);
}

TEST_P(PublishedModelTest, OfWhichAllElseHasMovedOnIsNotValidAnyMore) {
  add(3000);
  const auto message = publish();
  auto model = PublishedModel::open(message, wanted(), PublishedModel::Need::Average);
  ASSERT_TRUE(model);
  EXPECT_EQ(model->live().parameters, nullptr);
  add(10);
  EXPECT_FALSE(model->still_valid());
  EXPECT_FALSE(model->refresh());
  EXPECT_FALSE(PublishedModel::open(message, wanted()));
  auto next = PublishedModel::open(publish(), wanted());
  ASSERT_TRUE(next);
  expect_truth(*next);
}

TEST_P(PublishedModelTest, ThatGrowsKeepsItsAddress) {
  if (std::get<0>(GetParam()) != wanted()) GTEST_SKIP() << "copies have addresses of their own";
  add(5000);
  auto before = PublishedModel::open(publish(), wanted());
  ASSERT_TRUE(before);
  add(200'000);  // a second arena
  auto after = PublishedModel::open(publish(), wanted(), PublishedModel::Need::Both, &*before);
  ASSERT_TRUE(after);
  EXPECT_EQ(after->live().parameters, before->live().parameters);
  expect_truth(*after);
}

TEST_P(PublishedModelTest, ThatHasGrownByAnArenaSinceItWasToldIsReadLater) {
  add(5000);
  const auto told = publish();
  add(200'000);  // a second arena
  EXPECT_FALSE(PublishedModel::open(told, wanted()));
  auto after = PublishedModel::open(publish(), wanted());
  ASSERT_TRUE(after);
  expect_truth(*after);
}

TEST_P(PublishedModelTest, OverTcpThePagesInUseAreSentAndNotAllThatThereIsMemoryFor) {
  if (std::get<0>(GetParam()) == Device::Cuda) GTEST_SKIP() << "the broker copies from host memory";
  bus::Subscriber far(connect_tcp("far"), {"model/published"});
  ASSERT_TRUE(far.wait_connected(bus_test::patience));
  ASSERT_TRUE(maker_->wait_connected(bus_test::patience));
  add(3000);
  store_->publish(publisher_);
  const auto message = far.receive(bus_test::patience);
  ASSERT_TRUE(message);
  const auto pages = message->tensor("pages-0");
  ASSERT_TRUE(pages);
  EXPECT_EQ(pages->slab(), nullptr);
  EXPECT_LT(pages->bytes(), kArenaPages / 4 * page_bytes({}));
  auto model = PublishedModel::open(*message, wanted());
  ASSERT_TRUE(model);
  expect_truth(*model);
}

// The broker copies later than the trainer told.
TEST_P(PublishedModelTest, OverTcpAPageThatHasComeSinceItWasToldIsReadLater) {
  if (std::get<0>(GetParam()) == Device::Cuda) GTEST_SKIP() << "the broker copies from host memory";
  bus::Subscriber far(connect_tcp("far"), {"model/published"});
  ASSERT_TRUE(far.wait_connected(bus_test::patience));
  ASSERT_TRUE(maker_->wait_connected(bus_test::patience));
  add(3000);
  PageEntry& next = store_->table().entry((store_->view().ranges.back().first >> kPageShift) + 1);
  next.now = {.state = PageState::Active, .count = 5};
  store_->publish(publisher_);
  auto message = far.receive(bus_test::patience);
  ASSERT_TRUE(message);
  EXPECT_FALSE(PublishedModel::open(*message, wanted()));
  next.now = {};
  store_->publish(publisher_);
  message = far.receive(bus_test::patience);
  ASSERT_TRUE(message);
  const auto model = PublishedModel::open(*message, wanted());
  ASSERT_TRUE(model);
  expect_truth(*model);
}

TEST_P(PublishedModelTest, FrozenPagesAreReadAsOthers) {
  add(3000);
  const std::uint32_t page = store_->view().ranges.front().first >> kPageShift;
  const auto before = PublishedModel::open(publish(), wanted());
  store_->freeze(std::span(&page, 1));
  EXPECT_FALSE(before->still_valid());
  auto frozen = PublishedModel::open(publish(), wanted());
  ASSERT_TRUE(frozen);
  EXPECT_EQ(frozen->live().ranges.front().frozen, 1U);
  EXPECT_EQ(frozen->live().ranges.back().frozen, 0U);
  expect_truth(*frozen);
}

TEST_P(PublishedModelTest, ATableThatLiesIsRefused) {
  add(3000);
  const auto message = publish();
  PageEntry& entry = store_->table().entry(store_->view().ranges.front().first >> kPageShift);
  const auto refusal = [&] {
    try {
      (void)PublishedModel::open(message, wanted());
    } catch (const bus::Error& error) {
      return std::string(error.what());
    }
    return std::string("accepted");
  };
  const PageStructure honest = entry.now;
  entry.now.count = kPageLanes + 1;
  EXPECT_THAT(refusal(), testing::AllOf(HasSubstr("trainer"), HasSubstr("1025 Gaussians")));
  entry.now = honest;
  PageEntry& far = store_->table().entry(store_->table().page_capacity() - 1);
  far.now = {.state = PageState::Active, .count = 5};
  EXPECT_EQ(refusal(), "accepted");
  EXPECT_FALSE(PublishedModel::open(message, wanted())) << "of an arena that is not there it may tell later";
  far.now = {};
  entry.generation += 1;
  EXPECT_FALSE(PublishedModel::open(message, wanted())) << "a page that changes is read later";
  entry.generation -= 1;
  store_->table().header().magic = 1;
  EXPECT_THAT(refusal(), HasSubstr("page table"));
}

constexpr auto kAnyDevice = {Device::Cpu, Device::Cuda};
INSTANTIATE_TEST_SUITE_P(Devices, PublishedModelTest,
                         testing::Combine(testing::ValuesIn(kAnyDevice), testing::ValuesIn(kAnyDevice)));

}  // namespace

}  // namespace splatbus::model
