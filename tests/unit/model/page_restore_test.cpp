// Pages that leave a store, and come back to it or to another one.
#include <bit>
#include <limits>

#include "page_store_fixture.h"

namespace splatbus::model {

namespace {

constexpr std::uint32_t kIdRow = 89;  // of a page of the layout Transfer; the rows before it are floats

/// A page's content, copied by hand.
struct Kept {
  PageStructure structure;
  std::vector<std::uint32_t> words;
  [[nodiscard]] PageContent content() const { return {structure, words}; }
};

class PageRestoreTest : public PageStoreTest {
 protected:
  [[nodiscard]] Kept keep(std::uint32_t page) const {
    const std::size_t words = page_words(store_->layout());
    const auto block = to_host(store_->device(), store_->memory().words + page * words, words);
    Kept kept{.structure = store_->table().entry(page).now, .words = {}};
    for (std::uint32_t row = 0; row < kIdRow; ++row) {
      kept.words.insert(kept.words.end(), block.begin() + row * kRowWords,
                        block.begin() + row * kRowWords + kept.structure.count);
    }
    kept.words.insert(kept.words.end(), block.begin() + kIdRow * kRowWords,
                      block.begin() + kIdRow * kRowWords + 2 * kept.structure.count);
    return kept;
  }
  [[nodiscard]] std::vector<std::uint32_t> pages() const {
    std::vector<std::uint32_t> result;
    for (const IndexRange& range : store_->view().ranges) result.push_back(range.first / kPageLanes);
    return result;
  }
  [[nodiscard]] std::vector<Kept> keep_all() const {
    std::vector<Kept> all;
    for (const std::uint32_t page : pages()) all.push_back(keep(page));
    return all;
  }
  static std::vector<PageContent> contents(const std::vector<Kept>& kept) {
    std::vector<PageContent> all;
    for (const Kept& page : kept) all.push_back(page.content());
    return all;
  }

  void fill(std::size_t batches) {
    for (std::size_t b = 0; b < batches; ++b) {
      const Batch batch = make_batch(random_, 3000, b % 2 == 0, 3);
      insert(*store_, batch, next_batch_++);
      truth_.insert(batch, batch.count);
    }
  }

  /// Another one, empty, with nothing of the first but its slabs' name.
  void start_anew(std::size_t max_gaussians) {
    for (const char* role : {"page-table", "pages-0"}) context_->drop_slab(role);
    start(max_gaussians);
    ASSERT_EQ(store_->count(), 0U);
  }

  std::uint64_t next_batch_ = 1;
};

TEST_P(PageRestoreTest, WhatWasKeptIsThereAgainByIdAndGoesOn) {
  start(100000);
  fill(5);
  const std::vector<std::uint32_t> before = pages();
  store_->freeze(std::span(before).first(3));
  truth_.gaussians.clear();  // freezing took the averages
  for (const auto& [id, place] : Found(*store_).by_id) truth_.gaussians[id] = place.gaussian;
  const std::vector<Kept> kept = keep_all();
  const std::uint64_t next_id = store_->next_gaussian_id();
  start_anew(100000);
  const std::vector<std::uint32_t> placed = store_->restore(contents(kept), next_id);
  store_->set_progress(7, 8, 2.5);
  expect_sound();
  EXPECT_EQ(store_->step(), 7U);
  EXPECT_EQ(store_->views(), 8U);
  EXPECT_EQ(store_->optimizer_s(), 2.5);
  EXPECT_EQ(store_->next_gaussian_id(), next_id);
  EXPECT_EQ(store_->frozen_pages(), 3U);
  for (std::size_t p = 0; p < kept.size(); ++p) {
    const PageStructure& now = store_->table().entry(placed[p]).now;
    EXPECT_EQ(now.state, kept[p].structure.state);
    EXPECT_EQ(now.morton_first, kept[p].structure.morton_first);
    EXPECT_EQ(now.id_first, kept[p].structure.id_first);
  }
  fill(2);
  expect_sound();
  // And the next one finds it where it is.
  store_.reset();
  start(100000);
  expect_sound();
}

TEST_P(PageRestoreTest, OnlyWhatIsSoundComesIn) {
  start(100000);
  fill(1);
  std::vector<Kept> kept = keep_all();
  ASSERT_GT(kept.size(), 3U);
  const std::uint64_t next_id = store_->next_gaussian_id();
  const auto set_id = [&](Kept& page, std::uint32_t lane, std::uint64_t id) {
    std::memcpy(page.words.data() + kIdRow * page.structure.count + 2 * lane, &id, sizeof(id));
  };
  const auto id_at = [&](const Kept& page, std::uint32_t lane) {
    std::uint64_t id = 0;
    std::memcpy(&id, page.words.data() + kIdRow * page.structure.count + 2 * lane, sizeof(id));
    return id;
  };
  const auto spoil = [&](Kept& page, std::uint32_t row, std::uint32_t lane, float value) {
    page.words[row * page.structure.count + lane] = std::bit_cast<std::uint32_t>(value);
  };
  truth_.remove({id_at(kept[0], 0), id_at(kept[0], 5), id_at(kept[0], 6), id_at(kept[0], 9)});
  spoil(kept[0], 0, 0, std::numeric_limits<float>::quiet_NaN());
  spoil(kept[0], 88, 5, -std::numeric_limits<float>::infinity());
  set_id(kept[0], 6, 0);
  set_id(kept[0], 9, next_id);
  std::vector<PageContent> offered = contents(kept);
  // A page with nothing in it that counts, and sizes that lie.
  Kept broken = kept[1];
  broken.structure.id_first += 1;
  for (std::uint32_t lane = 0; lane < broken.structure.count; ++lane) set_id(broken, lane, 0);
  offered.push_back(broken.content());
  PageContent lying = kept[2].content();
  lying.structure.id_first += 1;
  for (const std::uint32_t count : {0U, lying.structure.count - 1, kPageLanes + 1, 0xFFFFFFFFU}) {
    lying.structure.count = count;
    offered.push_back(lying);
  }
  lying = kept[2].content();
  lying.structure.id_first += 1;
  lying.structure.state = PageState::Spilled;
  offered.push_back(lying);
  offered.push_back(kept[3].content());  // twice
  start_anew(100000);
  const std::vector<std::uint32_t> placed = store_->restore(offered, next_id);
  for (std::size_t p = 0; p < placed.size(); ++p) EXPECT_EQ(placed[p] != kNotInserted, p < kept.size()) << p;
  expect_sound();
}

TEST_P(PageRestoreTest, MemoryStaysBounded) {
  start(100000);
  fill(2);
  const std::vector<Kept> kept = keep_all();
  const std::uint64_t next_id = store_->next_gaussian_id();
  start_anew(3500);
  const std::vector<std::uint32_t> placed = store_->restore(contents(kept), next_id);
  EXPECT_LE(store_->count(), 3500U);
  EXPECT_GT(store_->count(), 2500U);
  EXPECT_EQ(std::count(placed.begin(), placed.end(), kNotInserted),
            static_cast<std::ptrdiff_t>(kept.size() - store_->page_count()));
}

/// Ranges of pages, made by hand from where their samples were.
SpilledRange range_of(const Kept& page) {
  const std::uint32_t count = page.structure.count;
  SpilledRange range{.frame_id = page.structure.frame_id,
                     .morton_first = page.structure.morton_first,
                     .id_first = page.structure.id_first,
                     .low_m = {1e9F, 1e9F, 1e9F},
                     .high_m = {-1e9F, -1e9F, -1e9F}};
  for (std::uint32_t lane = 0; lane < count; ++lane) {
    float at[3];
    for (std::uint32_t axis = 0; axis < 3; ++axis) {
      at[axis] = std::bit_cast<float>(page.words[(kIdRow - 4 + axis) * count + lane]);
    }
    range.morton_last = std::max(range.morton_last, slow_key(at));
    range.low_m = {std::min(range.low_m.x, at[0]), std::min(range.low_m.y, at[1]), std::min(range.low_m.z, at[2])};
    range.high_m = {std::max(range.high_m.x, at[0]), std::max(range.high_m.y, at[1]), std::max(range.high_m.z, at[2])};
  }
  return range;
}

TEST_P(PageRestoreTest, WhatIsTakenOutIsNotPutInTwiceAndComesBack) {
  start(100000);
  std::vector<Batch> batches;
  for (std::uint64_t b = 0; b < 6; ++b) {
    batches.push_back(make_batch(random_, 2500, true, 2));
    insert(*store_, batches.back(), next_batch_++);
    truth_.insert(batches.back(), batches.back().count);
  }
  // Every other page, and with them the first of each frame.
  std::vector<std::uint32_t> out;
  std::vector<Kept> kept;
  std::vector<SpilledRange> ranges;
  Truth rest = truth_;
  for (const std::uint32_t page : pages()) {
    const PageStructure& now = store_->table().entry(page).now;
    if (out.size() % 2 == 1 && now.morton_first != 0 && page % 3 != 0) continue;
    out.push_back(page);
    kept.push_back(keep(page));
    ranges.push_back(range_of(kept.back()));
    for (std::uint32_t lane = 0; lane < now.count; ++lane) {
      rest.gaussians.erase(id_of(store_->layout(), kept.back().content(), lane));
    }
  }
  ASSERT_LT(rest.gaussians.size(), truth_.gaussians.size() * 3 / 4);
  ASSERT_GT(rest.gaussians.size(), truth_.gaussians.size() / 8);
  const std::size_t arenas = store_->memory().words != nullptr ? pages().back() / kArenaPages : 0;
  store_->take_out(out);
  store_->set_spilled(ranges);
  EXPECT_EQ(store_->count(), rest.gaussians.size());
  expect_whole(Found(*store_), rest);

  // The same samples again: those of spilled pages are left out, and no page takes the key of one that is spilled.
  std::size_t known = 0;
  for (const Batch& batch : batches) {
    for (std::size_t k = 0; k < batch.count; ++k) {
      const float at[3] = {batch.mean[k], batch.mean[batch.count + k], batch.mean[2 * batch.count + k]};
      const std::uint64_t key = slow_key(at);
      const bool spilled = std::any_of(ranges.begin(), ranges.end(), [&](const SpilledRange& range) {
        const auto within = [](float x, float low, float high) { return x >= low - 0.05F && x <= high + 0.05F; };
        return range.frame_id == batch.object_id[k] && key >= range.morton_first && key <= range.morton_last &&
               within(at[0], range.low_m.x, range.high_m.x) && within(at[1], range.low_m.y, range.high_m.y) &&
               within(at[2], range.low_m.z, range.high_m.z);
      });
      known += spilled ? 1 : 0;
    }
  }
  std::size_t left_out = 0;
  const std::size_t before = store_->count();
  for (const Batch& batch : batches) {
    const InsertResult result = insert(*store_, batch, next_batch_++);
    left_out += result.left_out;
    const auto added = to_host(store_->device(), result.added, result.left_out == result.count ? 0 : result.count);
    EXPECT_EQ(std::count(added.begin(), added.end(), kNotInserted),
              static_cast<std::ptrdiff_t>(added.empty() ? 0 : result.left_out));
  }
  EXPECT_EQ(left_out, known);
  EXPECT_GE(known, truth_.gaussians.size() - rest.gaussians.size());
  EXPECT_EQ(store_->count(), before + batches.size() * batches[0].count - left_out);
  const Found found(*store_);
  for (const std::uint32_t page : pages()) {
    const PageStructure& now = store_->table().entry(page).now;
    for (const SpilledRange& range : ranges) {
      EXPECT_FALSE(now.frame_id == range.frame_id && now.morton_first == range.morton_first &&
                   now.id_first == range.id_first);
    }
  }

  // They come back into what was freed.
  store_->set_spilled({});
  const std::vector<std::uint32_t> placed = store_->restore(contents(kept), store_->next_gaussian_id());
  EXPECT_EQ(std::count(placed.begin(), placed.end(), kNotInserted), 0);
  EXPECT_LE(*std::max_element(placed.begin(), placed.end()) / kArenaPages, arenas);
  const Found all(*store_);
  for (const auto& [id, gaussian] : truth_.gaussians) {
    ASSERT_TRUE(all.by_id.contains(id));
    EXPECT_EQ(all.by_id.at(id).gaussian, gaussian);
  }
}

TEST_P(PageRestoreTest, WhatWasKeptLongAgoGivesNoIdASecondTime) {
  start(100000);
  fill(1);
  const std::vector<std::uint32_t> out{pages().front()};
  const Kept kept = keep(out.front());
  const std::uint64_t next_id = store_->next_gaussian_id();
  store_->take_out(out);
  const auto insert_elsewhere = [&](std::uint32_t frame) {
    Batch batch = make_batch(random_, 2000, true, 1);
    batch.object_id.assign(batch.count, frame);
    insert(*store_, batch, next_batch_++);
    truth_.insert(batch, batch.count);
  };
  insert_elsewhere(8);
  const std::vector<PageContent> content{kept.content()};
  ASSERT_NE(store_->restore(content, next_id).front(), kNotInserted);
  expect_sound();
  insert_elsewhere(9);
  expect_sound();
}

INSTANTIATE_TEST_SUITE_P(Devices, PageRestoreTest, testing::Values(Device::Cpu, Device::Cuda), device_name);

}  // namespace

}  // namespace splatbus::model
