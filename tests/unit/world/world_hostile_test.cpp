// Folders that lie: nothing crashes, and what is given out was once written.
#include <algorithm>
#include <cstring>
#include <functional>

#include "world_fixture.h"

namespace splatbus::world {
namespace {

class HostileWorldTest : public WorldTest {
 protected:
  /// Three pages, each of them written twice, with a commit a page.
  void SetUp() override {
    World world(folder_, {.note = "note"});
    for (std::uint32_t version = 0; version < 2; ++version) {
      for (std::uint64_t p = 0; p < 3; ++p) {
        Page page = make_page(p, 2 + 3 * version, 1 + static_cast<std::uint32_t>(p));
        page.step = version;
        put(world, page);
        world.commit({.next_gaussian_id = 5, .step = version * 3 + p + 1});
        written_[page.key].push_back(page);
      }
    }
    world.mark(written_.begin()->first, PageMark::Spilled);
    world.commit({.next_gaussian_id = 5, .step = 7});
  }

  /// Opens it to read and to write. Whatever is found in it is one of what was written.
  std::size_t expect_harmless() {
    std::size_t pages = 0;
    for (const bool write : {false, true}) {
      std::unique_ptr<World> world;
      try {
        world = write ? std::make_unique<World>(folder_, WorldOptions{}) : std::make_unique<World>(folder_);
      } catch (const WorldError&) {
        continue;
      }
      pages = 0;
      for (const auto& [key, entry] : world->pages()) {
        auto page = world->read(key);
        if (!page) continue;
        ++pages;
        bool known = false;
        for (const Page& version : written_[key]) known |= version.words == page->words && version.step == page->step;
        EXPECT_TRUE(known) << "a page that nobody wrote";
      }
      EXPECT_LE(world->progress().step, 8U);
      if (write) {
        put(*world, extra_);
        written_[extra_.key] = {extra_};
        world->commit({.step = 8});
        while (world->compact()) {
        }
        world.reset();
        world = std::make_unique<World>(folder_);
        const auto again = world->read(extra_.key);
        EXPECT_TRUE(again && again->words == extra_.words) << "what is written into it now is lost";
      }
    }
    return pages;
  }

  /// Of a file of the folder.
  void each_change(const std::filesystem::path& file, const std::function<void(Bytes&, std::size_t)>& change,
                   std::size_t stride) {
    const std::filesystem::path copy = folder_.parent_path() / "copy";
    std::filesystem::copy(folder_, copy, std::filesystem::copy_options::recursive);
    const Bytes original = read_bytes(file);
    for (std::size_t at = 0; at < original.size(); at += stride) {
      SCOPED_TRACE(at);
      Bytes bytes = original;
      change(bytes, at);
      write_bytes(file, bytes);
      expect_harmless();
      if (HasFailure()) return;
      std::filesystem::remove_all(folder_);
      std::filesystem::copy(copy, folder_, std::filesystem::copy_options::recursive);
    }
  }

  std::map<PageKey, std::vector<Page>> written_;
  Page extra_ = make_page(99, 3, 99);
};

TEST_F(HostileWorldTest, ASegmentThatEndsAnywhere) {
  each_change(
      segment(1), [](Bytes& bytes, std::size_t at) { bytes.resize(at); }, 41);
}

TEST_F(HostileWorldTest, AByteOfASegmentIsAnother) {
  each_change(
      segment(1), [](Bytes& bytes, std::size_t at) { bytes[at] ^= 0x41; }, 7);
}

TEST_F(HostileWorldTest, ManyBytesOfASegmentAreOthers) {
  std::mt19937 random(3);
  each_change(
      segment(1),
      [&](Bytes& bytes, std::size_t) {
        for (int k = 0; k < 20; ++k) bytes[random() % bytes.size()] = static_cast<unsigned char>(random());
      },
      31);
}

TEST_F(HostileWorldTest, PiecesOfASegmentAreMissingOrThereTwice) {
  std::mt19937 random(4);
  each_change(
      segment(1),
      [&](Bytes& bytes, std::size_t at) {
        const std::size_t end = std::min(bytes.size(), at + random() % 300);
        const Bytes piece(bytes.begin() + static_cast<std::ptrdiff_t>(at),
                          bytes.begin() + static_cast<std::ptrdiff_t>(end));
        if (random() % 2 == 0) {
          bytes.erase(bytes.begin() + static_cast<std::ptrdiff_t>(at),
                      bytes.begin() + static_cast<std::ptrdiff_t>(end));
        } else {
          bytes.insert(bytes.begin() + static_cast<std::ptrdiff_t>(random() % bytes.size()), piece.begin(),
                       piece.end());
        }
      },
      17);
}

TEST_F(HostileWorldTest, ASegmentThatCannotBeReadIsRefusedAlone) {
  const std::size_t pages = World(folder_).pages().size();
  // A folder opens to be read like a file whose disk fails: each read is refused.
  std::filesystem::create_directory(folder_ / "segments" / "000007.seg");
  const World world(folder_);
  EXPECT_GT(pages, 0U);
  EXPECT_EQ(world.pages().size(), pages);
  EXPECT_TRUE(std::ranges::any_of(world.damage(), [](const Damage& damage) {
    return damage.file.find("000007.seg") != std::string::npos &&
           damage.what.find("cannot be read") != std::string::npos;
  }));
}

TEST_F(HostileWorldTest, AManifestThatLiesIsRefused) {
  const std::filesystem::path file = folder_ / "world.splatbus";
  const Bytes original = read_bytes(file);
  for (std::size_t at = 0; at < original.size(); ++at) {
    SCOPED_TRACE(at);
    Bytes changed = original;
    changed[at] ^= 0x20;
    write_bytes(file, changed);
    EXPECT_THROW(World{folder_}, WorldError);
    changed.resize(at);
    write_bytes(file, changed);
    EXPECT_THROW(World{folder_}, WorldError);
  }
  Bytes large = original;
  large.resize(1 << 20);
  write_bytes(file, large);
  EXPECT_THROW(World{folder_}, WorldError);
  std::filesystem::remove(file);
  EXPECT_THROW(World(folder_, {}), WorldError) << "segments without a manifest";
}

/// Every size that a header claims, with checksums that are right.
TEST_F(HostileWorldTest, SizesAreBoundedBeforeMemoryIsTaken) {
  const Bytes original = read_bytes(segment(1));
  for (const std::uint32_t length : {0U, 55U, 1U << 20U, (1U << 20U) + 1, 0x7FFFFFFFU, 0xFFFFFFFFU}) {
    Bytes bytes = original;
    std::memcpy(bytes.data() + 32 + 8, &length, 4);
    const std::uint32_t crc = crc32_of(bytes.data() + 32, 60);
    std::memcpy(bytes.data() + 32 + 60, &crc, 4);
    write_bytes(segment(1), bytes);
    expect_harmless();
  }
  std::uint32_t old_length = 0;
  std::memcpy(&old_length, original.data() + 32 + 8, 4);
  for (const std::uint32_t count : {0U, 1025U, 0xFFFFFFFFU}) {
    for (const std::size_t field : {0U, 4U, 8U}) {
      Bytes bytes = original;
      std::memcpy(bytes.data() + 96 + field, &count, 4);
      const std::uint32_t payload_crc = crc32_of(bytes.data() + 96, old_length);
      std::memcpy(bytes.data() + 32 + 12, &payload_crc, 4);
      const std::uint32_t crc = crc32_of(bytes.data() + 32, 60);
      std::memcpy(bytes.data() + 32 + 60, &crc, 4);
      write_bytes(segment(1), bytes);
      const World world(folder_);
      ASSERT_EQ(world.damage().size(), 1U);
    }
  }
}

TEST_F(HostileWorldTest, ADamagedPageIsNamedAndLeftOut) {
  World(folder_, {});
  Bytes bytes = read_bytes(segment(1));
  // The last page record: from the end, the mark and commits around it are small.
  std::size_t last = 0, offset = 32;
  while (offset + 64 <= bytes.size()) {
    std::uint32_t kind = 0, length = 0;
    std::memcpy(&kind, bytes.data() + offset + 4, 4);
    std::memcpy(&length, bytes.data() + offset + 8, 4);
    if (kind == 1) last = offset;
    offset += 64 + length;
  }
  bytes[last + 64 + 60] ^= 1;
  write_bytes(segment(1), bytes);
  World world(folder_);
  ASSERT_EQ(world.damage().size(), 1U);
  EXPECT_EQ(world.damage()[0].file, segment(1).string());
  EXPECT_EQ(world.damage()[0].offset, last);
  EXPECT_NE(world.damage()[0].text().find("checksum"), std::string::npos);
  ASSERT_EQ(world.lost().size(), 1U);
  EXPECT_EQ(world.lost()[0], make_page(2, 1, 3).key);
  EXPECT_EQ(world.pages().size(), 2U) << "neither the damaged one nor the one before it";
}

/// A page that is damaged must not come back as it was before when what is damaged is thrown away.
TEST_F(HostileWorldTest, CompactionBringsNothingBackThatDamageHasTaken) {
  const PageKey key{.morton = 1, .id = 2};
  std::filesystem::remove_all(folder_);
  const WorldOptions options{.segment_bytes = 4096};
  {
    World world(folder_, options);
    Page page = make_page(1, 4, 3);
    page.key = key;
    const Page other = make_page(2, 7, 3);
    put(world, page);
    put(world, other);
    world.commit({});
    for (std::uint32_t k = 0; k < 4; ++k) {
      if (k == 1) put(world, page);
      put(world, make_page(3 + k, 9, 3));
      world.commit({});
    }
    ASSERT_GT(world.segments(), 2U);
  }
  // Its newer record.
  const World before(folder_);
  const PageEntry entry = *before.find(key);
  ASSERT_GT(entry.segment, 1U);
  Bytes bytes = read_bytes(segment(static_cast<int>(entry.segment)));
  bytes[entry.offset + 64 + 60] ^= 1;
  write_bytes(segment(static_cast<int>(entry.segment)), bytes);
  {
    World world(folder_, options);
    EXPECT_FALSE(world.find(key));
    for (std::uint32_t k = 0; k < 40; ++k) {  // until its segment has hardly anything that counts
      put(world, make_page(3 + k % 4, 9, 3));
      world.commit({});
      while (world.compact()) {
      }
    }
    EXPECT_FALSE(std::filesystem::exists(segment(static_cast<int>(entry.segment))));
    EXPECT_TRUE(std::filesystem::exists(segment(1)));
  }
  EXPECT_FALSE(World(folder_).find(key));
}

}  // namespace
}  // namespace splatbus::world
