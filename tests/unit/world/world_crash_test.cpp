// Writers that are killed.
#include <signal.h>
#include <sys/wait.h>

#include <array>

#include "world_fixture.h"

namespace splatbus::world {
namespace {

constexpr std::uint32_t kPages = 6;

/// Round after round, all pages get the round's number in one commit, one of them is taken away and one comes back;
/// each round that is committed is told.
[[noreturn]] void write_without_end(const std::filesystem::path& folder, int tell) {
  World world(folder, {.segment_bytes = 60000});
  for (std::uint64_t round = world.progress().step + 1;; ++round) {
    for (std::uint32_t p = 0; p < kPages; ++p) {
      Page page{.key = {.morton = p, .id = p}, .count = 3, .step = round};
      page.words.assign(std::size_t{91} * page.count, static_cast<std::uint32_t>(round));
      if (round % kPages == p) {
        world.remove(page.key);
      } else {
        world.put(page, encode_page(page, world.layout()));
      }
    }
    world.commit({.next_gaussian_id = round, .step = round}, round % 2 == 0);
    if (::write(tell, &round, sizeof(round)) != sizeof(round)) ::_exit(1);
    while (world.compact()) {
    }
  }
}

TEST_F(WorldTest, WhereverAWriterIsKilledItsLastCommitStandsAsAWhole) {
  std::mt19937 random(9);
  std::uint64_t last = 0;
  for (int kill = 0; kill < 40; ++kill) {
    std::array<int, 2> pipe{};
    ASSERT_EQ(::pipe(pipe.data()), 0);
    const pid_t child = ::fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      ::close(pipe[0]);
      write_without_end(folder_, pipe[1]);
    }
    ::close(pipe[1]);
    const std::uint64_t rounds = 1 + random() % 8;
    std::uint64_t told = 0;
    for (std::uint64_t r = 0; r < rounds; ++r) ASSERT_EQ(::read(pipe[0], &told, sizeof(told)), ssize_t{sizeof(told)});
    ::usleep(random() % 2000);  // anywhere in a round
    ::kill(child, SIGKILL);
    ::waitpid(child, nullptr, 0);
    for (std::uint64_t more = 0; ::read(pipe[0], &more, sizeof(more)) == ssize_t{sizeof(more)};) told = more;
    ::close(pipe[0]);

    World world(folder_);
    const std::uint64_t round = world.progress().step;
    EXPECT_GE(round, told) << "a commit that was told is lost";
    EXPECT_GT(round, last);
    EXPECT_LE(round, told + 1);
    last = round;
    EXPECT_TRUE(world.damage().empty());
    EXPECT_EQ(world.pages().size(), kPages - 1);
    EXPECT_FALSE(world.find({.morton = round % kPages, .id = round % kPages}));
    for (const auto& [key, entry] : world.pages()) {
      const auto page = world.read(key);
      ASSERT_TRUE(page);
      EXPECT_EQ(page->step, round);
      EXPECT_EQ(page->words[5], static_cast<std::uint32_t>(round));
    }
    if (HasFailure()) return;
  }
}

}  // namespace
}  // namespace splatbus::world
