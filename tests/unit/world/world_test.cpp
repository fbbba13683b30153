#include <signal.h>
#include <sys/resource.h>

#include <chrono>
#include <future>

#include "model/channels.h"
#include "world/gathered_model.h"
#include "world_fixture.h"

namespace splatbus::world {
namespace {

/// Writing beyond fails, as on a disk that is full. Returns the limit before.
rlimit limit_files_to(std::size_t bytes) {
  ::signal(SIGXFSZ, SIG_IGN);
  rlimit before{};
  ::getrlimit(RLIMIT_FSIZE, &before);
  const rlimit limit{.rlim_cur = bytes, .rlim_max = before.rlim_max};
  ::setrlimit(RLIMIT_FSIZE, &limit);
  return before;
}

TEST_F(WorldTest, WhatWasCommittedIsThereAgainBitByBit) {
  std::map<PageKey, Page> truth;
  const WorldProgress progress{.next_gaussian_id = 77, .step = 5, .views = 9, .optimizer_s = 1.5, .generation = 12};
  {
    World world(folder_, {.note = "a courtyard"});
    for (std::uint32_t p = 0; p < 20; ++p) {
      Page page = make_page(p, p == 19 ? kPageLanes : 1 + 7 * p, p);
      page.state = p % 2 == 0 ? model::PageState::Active : model::PageState::Frozen;
      put(world, page);
      truth[page.key] = page;
    }
    world.commit(progress);
    expect_holds(world, truth);
  }
  World again(folder_, {});
  expect_holds(again, truth);
  EXPECT_EQ(again.progress(), progress);
  EXPECT_EQ(again.manifest().note, "a courtyard");
  EXPECT_EQ(again.manifest().epoch, 2U);
  EXPECT_TRUE(again.damage().empty());
  EXPECT_EQ(again.cut_bytes(), 0U);
}

TEST_F(WorldTest, AModelIsGatheredPageAfterPage) {
  const Page first = make_page(1, 10, 1), second = make_page(2, 3, 2);  // of frames 1 and 2
  World world(folder_, {});
  put(world, second);
  put(world, first);
  world.commit({});
  const GatheredModel gathered = gather_model(world);
  const GaussiansBuffer& model = gathered.gaussians;
  EXPECT_EQ(gathered.page_ends, (std::vector<std::size_t>{10, 13}));
  ASSERT_EQ(model.count(), 13U);
  const auto value = [&](const Page& page, model::Channel channel, std::uint32_t row, std::uint32_t lane) {
    const std::uint32_t first_row = model::rows_of(channel, world.layout()).first;
    return std::bit_cast<float>(page.words[(first_row + row) * page.count + lane]);
  };
  for (std::uint32_t i = 0; i < 13; ++i) {
    const Page& page = i < 10 ? first : second;
    const std::uint32_t lane = i < 10 ? i : i - 10;
    EXPECT_EQ(model.object_id[i], i < 10 ? 1U : 2U);
    EXPECT_EQ(model.gaussian_id[i], (i < 10 ? 2000U : 4000U) + lane);
    for (const int channel : {0, 40}) {
      EXPECT_EQ(model.view().plane(channel)[i],
                value(page, model::Channel::Average, static_cast<std::uint32_t>(channel), lane));
    }
    EXPECT_EQ(model.normal[2 * model.stride() + i], value(page, model::Channel::Normal, 2, lane));
    EXPECT_EQ(model.surface_point[model.stride() + i], value(page, model::Channel::SurfacePoint, 1, lane));
    EXPECT_EQ(model.visibility[i], value(page, model::Channel::Visibility, 0, lane));
  }
}

TEST_F(WorldTest, ALivePageTakesLessThanTwoThirdsOfItsMemory) {
  const Page page = make_page(3, kPageLanes, 3);
  EXPECT_LT(encode_page(page, {}).size(), page.words.size() * 4 * 2 / 3);
}

TEST_F(WorldTest, WhatWasNotCommittedNeverWas) {
  const Page first = make_page(1, 10, 1), second = make_page(2, 10, 2);
  Page newer = make_page(1, 20, 1);
  {
    World world(folder_, {});
    put(world, first);
    world.commit({.step = 1});
    put(world, newer);
    put(world, second);
    world.remove(first.key);
    EXPECT_EQ(world.pages().size(), 1U);
  }
  {
    World world(folder_, {});
    EXPECT_GT(world.cut_bytes(), 0U);
    EXPECT_TRUE(world.damage().empty());
    expect_holds(world, {{first.key, first}});
    put(world, second);
    world.abandon();
    put(world, newer);
    world.commit({.step = 2});
  }
  World world(folder_, {});
  expect_holds(world, {{newer.key, newer}});
  EXPECT_EQ(world.cut_bytes(), 0U);
}

TEST_F(WorldTest, AReaderSeesTheLastCommitWhileAnotherProcessWrites) {
  World writer(folder_, {});
  const Page first = make_page(1, 10, 1), second = make_page(2, 10, 2);
  put(writer, first);
  writer.commit({});
  put(writer, second);
  World reader(folder_);
  expect_holds(reader, {{first.key, first}});
  EXPECT_TRUE(reader.damage().empty());
  EXPECT_THROW(put(reader, second), WorldError);
}

TEST_F(WorldTest, WhoeverAsksWaitsForNoDisk) {
  World* asked = nullptr;
  const Page first = make_page(0, 30, 1), second = make_page(100, 30, 2);
  int answered = 0;
  std::vector<std::future<bool>> late;  // until the disk is done, or the test would never end
  // While the disk works, another thread asks.
  const auto sync = [&](const File&) {
    if (asked == nullptr) return;
    auto answer = std::async(std::launch::async, [&] {
      return asked->find(first.key).has_value() && asked->bytes() > 0 && asked->live_bytes() > 0 &&
             asked->read(first.key).has_value();
    });
    if (answer.wait_for(std::chrono::seconds(10)) == std::future_status::ready) {
      answered += answer.get() ? 1 : 0;
    } else {
      ADD_FAILURE() << "it waits for the disk";
      late.push_back(std::move(answer));
    }
  };
  WorldOptions options;
  options.segment_bytes = 16384;
  options.sync = sync;
  World world(folder_, options);
  put(world, first);
  world.commit({.next_gaussian_id = 10000});
  asked = &world;
  put(world, second);
  world.commit({.next_gaussian_id = 10000});
  EXPECT_GE(answered, 1);
  // And while segments are rewritten.
  for (std::uint32_t k = 0; k < 6; ++k) put(world, make_page(100, 30, 2));
  world.commit({.next_gaussian_id = 10000});
  answered = 0;
  EXPECT_TRUE(world.compact());
  EXPECT_GE(answered, 1);
  EXPECT_TRUE(world.read(second.key));
}

/// Where a folder comes near what it may take, segments are rewritten that would else be left alone.
TEST_F(WorldTest, ACommitBringsAllThatWentBeforeItToDisk) {
  std::map<std::filesystem::path, std::uintmax_t> on_disk;
  WorldOptions options{.segment_bytes = 20000};
  options.sync = [&](const File& file) { on_disk[file.path()] = std::filesystem::file_size(file.path()); };
  World world(folder_, options);
  std::uint32_t pages = 0;
  for (std::size_t round = 1; round <= 3; ++round) {
    const std::size_t segments = world.segments();
    while (world.segments() < segments + 3) put(world, make_page(10 * pages++, 20, 2));
    world.commit({.next_gaussian_id = 10000});
    for (const auto& entry : std::filesystem::directory_iterator(folder_ / "segments")) {
      EXPECT_EQ(on_disk[entry.path()], entry.file_size()) << entry.path().filename() << ", commit " << round;
    }
  }
}

TEST_F(WorldTest, NearItsCeilingLessIsWasted) {
  for (const bool bounded : {false, true}) {
    WorldOptions options{.segment_bytes = 60000};
    options.max_bytes = bounded ? 70000 : 0;
    World world(folder_ / (bounded ? "bounded" : "free"), options);
    std::uint32_t pages = 0;
    while (world.segments() < 2) {
      put(world, make_page(10 * pages++, 20, 2));
      world.commit({.next_gaussian_id = 10000});
    }
    for (std::uint32_t k = 0; k < (pages + 3) / 4; ++k) put(world, make_page(10 * k, 20, 5));
    world.commit({.next_gaussian_id = 10000});
    const std::uint64_t before = world.bytes();
    EXPECT_EQ(world.is_crowded(), bounded);
    EXPECT_EQ(world.compact(), bounded) << "a quarter of it is waste";
    EXPECT_EQ(world.bytes() < before, bounded);
    EXPECT_EQ(world.pages().size(), pages);
  }
}

TEST_F(WorldTest, OnlyOneWriterAtATime) {
  {
    const World world(folder_, {});
    EXPECT_THROW(World(folder_, {}), WorldError);
  }
  EXPECT_NO_THROW(World(folder_, {}));
}

TEST_F(WorldTest, AnotherLayoutIsRefused) {
  { const World world(folder_, {}); }
  EXPECT_THROW(World(folder_, {.layout = {.appearance = Appearance::Radiance}}), WorldError);
  EXPECT_NO_THROW(World(folder_, {}));
}

/// Whatever is written, removed, marked and compacted in whatever order: what counts is the same, now and when it is
/// opened again.
TEST_F(WorldTest, CompactionChangesNothingButTheBytes) {
  std::mt19937 random(5);
  std::map<PageKey, Page> truth;
  WorldOptions options{.segment_bytes = 20000};
  auto world = std::make_unique<World>(folder_, options);
  std::size_t compactions = 0;
  for (std::uint32_t round = 0; round < 400; ++round) {
    const std::uint32_t changes = random() % 4;
    for (std::uint32_t c = 0; c < changes; ++c) {
      Page page = make_page(random() % 30, 1 + random() % 40, random() % 1000);
      page.key.frame_id = 0;
      const auto known = truth.find(page.key);
      switch (random() % 4) {
        case 0:
          world->remove(page.key);
          truth.erase(page.key);
          break;
        case 1:
          if (known == truth.end()) break;
          known->second.mark = random() % 2 == 0 ? PageMark::Spilled : PageMark::Fetched;
          world->mark(page.key, known->second.mark);
          break;
        default:
          put(*world, page);
          truth[page.key] = page;
      }
    }
    world->commit({.step = round}, false);
    while (random() % 2 == 0 && world->compact()) ++compactions;
    if (round % 40 == 0) {
      world.reset();
      world = std::make_unique<World>(folder_, options);
      ASSERT_EQ(world->progress().step, round);
    }
    if (round % 10 == 0) expect_holds(*world, truth);
    if (HasFailure()) return;
  }
  EXPECT_GT(compactions, 20U);
  while (world->compact()) {
  }
  std::size_t live = 0;
  for (const auto& [key, entry] : world->pages()) live += entry.bytes;
  EXPECT_LT(world->bytes(), 2 * live + 2 * options.segment_bytes);
  world.reset();
  world = std::make_unique<World>(folder_, options);
  expect_holds(*world, truth);
}

TEST_F(WorldTest, ADiskThatIsFullLosesOnlyWhatIsNotCommitted) {
  const Page first = make_page(1, 10, 1), second = make_page(2, 1000, 2);
  {
    World world(folder_, {});
    put(world, first);
    world.commit({});
    const rlimit before = limit_files_to(read_bytes(segment(1)).size() + 1000);
    EXPECT_THROW(put(world, second), WorldError);
    world.abandon();
    ::setrlimit(RLIMIT_FSIZE, &before);
    expect_holds(world, {{first.key, first}});
    put(world, second);
    world.commit({});
  }
  World world(folder_, {});
  EXPECT_EQ(world.cut_bytes(), 0U);
  EXPECT_TRUE(world.damage().empty());
  expect_holds(world, {{first.key, first}, {second.key, second}});
}

}  // namespace
}  // namespace splatbus::world
