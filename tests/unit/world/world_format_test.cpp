// The bytes, by hand: what docs/world-folder.md says and nothing of libs/world.
#include <zstd.h>

#include <cstring>

#include "world_fixture.h"

namespace splatbus::world {
namespace {

/// Bit by bit, reflected, 0xEDB88320.
std::uint32_t slow_crc(const Bytes& bytes, std::size_t first, std::size_t count) {
  std::uint32_t crc = 0xFFFFFFFF;
  for (std::size_t i = first; i < first + count; ++i) {
    crc ^= bytes[i];
    for (int bit = 0; bit < 8; ++bit) crc = (crc & 1U) != 0 ? crc >> 1U ^ 0xEDB88320U : crc >> 1U;
  }
  return ~crc;
}

struct Writer {
  Bytes bytes;
  void number(std::uint64_t value, int size) {
    for (int k = 0; k < size; ++k) bytes.push_back(static_cast<unsigned char>(value >> (8 * k)));
  }
  void real(double value) { number(std::bit_cast<std::uint64_t>(value), 8); }
  void real(float value) { number(std::bit_cast<std::uint32_t>(value), 4); }
  void text(const std::string& value) { bytes.insert(bytes.end(), value.begin(), value.end()); }
  void crc_from(std::size_t first) { number(slow_crc(bytes, first, bytes.size() - first), 4); }
};

Bytes manifest(std::uint64_t world_id, const std::string& note) {
  Writer w;
  w.text("spbworld");
  w.number(1, 4);   // version
  w.number(0, 4);   // transfer
  w.number(3, 4);   // degree
  w.number(91, 4);  // rows
  w.number(world_id, 8);
  w.number(4, 8);  // epoch
  w.number(1024, 4);
  w.number(note.size(), 4);
  w.text(note);
  w.crc_from(0);
  return w.bytes;
}

void segment_header(Writer& w, std::uint32_t number, std::uint64_t world_id) {
  const std::size_t first = w.bytes.size();
  w.text("spwbdseg");
  w.number(1, 4);
  w.number(number, 4);
  w.number(world_id, 8);
  w.number(0, 4);
  w.crc_from(first);
}

void record(Writer& w, std::uint32_t kind, std::uint64_t sequence, const PageKey& key, std::uint32_t mark,
            const Bytes& payload) {
  const std::size_t first = w.bytes.size();
  w.text("SREC");
  w.number(kind, 4);
  w.number(payload.size(), 4);
  w.number(slow_crc(payload, 0, payload.size()), 4);
  w.number(sequence, 8);
  w.number(key.frame_id, 4);
  w.number(key.level, 4);
  w.number(key.morton, 8);
  w.number(key.id, 8);
  w.number(mark, 4);
  w.number(0, 8);
  w.crc_from(first);
  w.bytes.insert(w.bytes.end(), payload.begin(), payload.end());
}

Bytes page_payload(const Page& page) {
  Writer w;
  w.number(page.count, 4);
  w.number(91, 4);
  w.number(page.state == model::PageState::Frozen ? 2 : 1, 4);
  for (const float value : {page.bounds.low.x, page.bounds.low.y, page.bounds.low.z, page.bounds.high.x,
                            page.bounds.high.y, page.bounds.high.z, page.bounds.max_scale_m}) {
    w.real(value);
  }
  w.number(page.step, 8);
  w.number(page.morton_last, 8);
  const std::size_t n = page.words.size(), averages = std::size_t{41} * page.count;
  Bytes planes(4 * n);
  for (std::size_t i = 0; i < n; ++i) {
    std::uint32_t word = page.words[i];
    if (i >= averages && i < 2 * averages) {
      const auto difference = static_cast<std::int32_t>(word - page.words[i - averages]);
      const std::int64_t wide = difference;
      word = static_cast<std::uint32_t>(wide >= 0 ? 2 * wide : -2 * wide - 1);
    }
    for (std::size_t k = 0; k < 4; ++k) planes[k * n + i] = static_cast<unsigned char>(word >> (8 * k));
  }
  Bytes frame(ZSTD_compressBound(planes.size()));
  frame.resize(ZSTD_compress(frame.data(), frame.size(), planes.data(), planes.size(), 3));
  w.bytes.insert(w.bytes.end(), frame.begin(), frame.end());
  return w.bytes;
}

Bytes commit_payload(const WorldProgress& progress) {
  Writer w;
  w.number(progress.next_gaussian_id, 8);
  w.number(progress.step, 8);
  w.number(progress.views, 8);
  w.real(progress.optimizer_s);
  w.number(progress.generation, 8);
  return w.bytes;
}

TEST_F(WorldTest, AFolderThatWasWrittenByHandIsRead) {
  constexpr std::uint64_t kWorld = 0x1122334455667788;
  std::filesystem::create_directories(folder_ / "segments");
  write_bytes(folder_ / "world.splatbus", manifest(kWorld, "by hand"));
  Page kept = make_page(5, 33, 1), frozen = make_page(9, 4, 2);
  const Page gone = make_page(7, 3, 4), older = make_page(5, 12, 1), never = make_page(11, 3, 5);
  frozen.state = model::PageState::Frozen;
  const WorldProgress progress{.next_gaussian_id = 90, .step = 8, .views = 16, .optimizer_s = 0.25, .generation = 3};
  Writer first, second;
  segment_header(first, 1, kWorld);
  record(first, 1, 1, gone.key, 0, page_payload(gone));
  record(first, 1, 2, older.key, 0, page_payload(older));
  record(first, 4, 3, {}, 0, commit_payload({.step = 1}));
  record(first, 1, 5, kept.key, 0, page_payload(kept));  // of a transaction that goes on in the next segment
  segment_header(second, 2, kWorld);
  record(second, 2, 6, gone.key, 0, {});
  record(second, 1, 7, frozen.key, 1, page_payload(frozen));
  record(second, 4, 8, {}, 0, commit_payload(progress));
  record(second, 3, 9, frozen.key, 2, {});
  record(second, 4, 10, {}, 0, commit_payload(progress));
  record(second, 1, 11, never.key, 0, page_payload(never));
  write_bytes(segment(1), first.bytes);
  write_bytes(segment(2), second.bytes);

  World world(folder_);
  EXPECT_EQ(world.manifest().world_id, kWorld);
  EXPECT_EQ(world.manifest().epoch, 4U);
  EXPECT_EQ(world.manifest().note, "by hand");
  EXPECT_EQ(world.progress(), progress);
  EXPECT_TRUE(world.damage().empty());
  frozen.mark = PageMark::Fetched;
  expect_holds(world, {{kept.key, kept}, {frozen.key, frozen}});
}

/// As when a file of an older copy of the folder is put back.
TEST_F(WorldTest, ARecordThatIsNotWhereItBelongsIsLeftOut) {
  std::filesystem::create_directories(folder_ / "segments");
  write_bytes(folder_ / "world.splatbus", manifest(9, ""));
  const Page kept = make_page(5, 33, 1), older = make_page(5, 12, 1);
  Writer first, second;
  segment_header(first, 1, 9);
  record(first, 1, 6, kept.key, 0, page_payload(kept));
  record(first, 4, 7, {}, 0, commit_payload({.step = 2}));
  segment_header(second, 2, 9);
  record(second, 1, 4, older.key, 0, page_payload(older));
  record(second, 4, 5, {}, 0, commit_payload({.step = 1}));
  write_bytes(segment(1), first.bytes);
  write_bytes(segment(2), second.bytes);
  World world(folder_);
  EXPECT_EQ(world.damage().size(), 2U);
  EXPECT_EQ(world.progress().step, 2U);
  expect_holds(world, {{kept.key, kept}});
}

TEST_F(WorldTest, WhatIsWrittenIsWhatTheFormatSays) {
  const Page page = make_page(5, 17, 1);
  const WorldProgress progress{.next_gaussian_id = 4, .step = 2, .views = 3, .optimizer_s = 7, .generation = 6};
  {
    World world(folder_, {.note = "n"});
    put(world, page);
    world.mark(page.key, PageMark::Spilled);
    world.commit(progress);
  }
  const Bytes is = read_bytes(segment(1));
  const Bytes head = read_bytes(folder_ / "world.splatbus");
  ASSERT_EQ(head.size(), 48U + 1 + 4);
  std::uint64_t world_id = 0;
  std::memcpy(&world_id, head.data() + 24, 8);
  EXPECT_NE(world_id, 0U);
  // Zstandard's bytes are its own affair: its frame is taken as it is, and then read by hand.
  std::uint32_t length = 0;
  ASSERT_GT(is.size(), 96U);
  std::memcpy(&length, is.data() + 32 + 8, 4);
  ASSERT_GT(is.size(), 96U + length);
  const Bytes payload(is.begin() + 96, is.begin() + 96 + length);
  Writer should;
  segment_header(should, 1, world_id);
  record(should, 1, 1, page.key, 0, payload);
  record(should, 3, 2, page.key, 1, {});
  record(should, 4, 3, {}, 0, commit_payload(progress));
  EXPECT_TRUE(is == should.bytes);

  const Bytes by_hand = page_payload(page);
  EXPECT_TRUE(std::equal(payload.begin(), payload.begin() + 56, by_hand.begin()));
  const auto planes = [](const Bytes& of) {
    Bytes raw(91 * 17 * 4);
    EXPECT_EQ(ZSTD_decompress(raw.data(), raw.size(), of.data() + 56, of.size() - 56), raw.size());
    return raw;
  };
  EXPECT_TRUE(planes(payload) == planes(by_hand));
}

}  // namespace
}  // namespace splatbus::world
