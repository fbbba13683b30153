#include "relight/page_shares.h"

#include <gtest/gtest.h>

#include <map>
#include <set>

#include "wire/system_generated.h"

namespace splatbus::relight {
namespace {

struct Seen {
  std::string source, kind = "relight";
  wire::ServiceState state = wire::ServiceState::Running;
  bool alive = true;
};

bool take(PageShares& shares, const std::vector<Seen>& nodes) {
  flatbuffers::FlatBufferBuilder builder;
  const auto header = wire::CreateHeaderDirect(builder, "Liveness/1", "bus");
  std::vector<flatbuffers::Offset<wire::Node>> all;
  for (const Seen& node : nodes) {
    all.push_back(
        wire::CreateNodeDirect(builder, node.source.c_str(), node.kind.c_str(), 1, 1, node.state, node.alive));
  }
  builder.Finish(wire::CreateLivenessDirect(builder, header, &all));
  return shares.take(*flatbuffers::GetRoot<wire::Liveness>(builder.GetBufferPointer()));
}

constexpr std::uint32_t kPages = 3000;

/// Who of them owns each page; fails where nobody or two do.
std::map<std::uint32_t, std::string> owners(const std::vector<std::string>& names) {
  std::vector<Seen> nodes;
  for (const std::string& name : names) nodes.push_back({name});
  std::map<std::uint32_t, std::string> owner;
  std::set<std::uint64_t> divisions;
  std::set<std::uint32_t> parts;
  for (const std::string& name : names) {
    PageShares shares(name);
    take(shares, nodes);
    divisions.insert(shares.division());
    parts.insert(shares.part());
    for (std::uint32_t page = 0; page < kPages; ++page) {
      if (!shares.owns(page)) continue;
      EXPECT_TRUE(owner.emplace(page, name).second) << page;
    }
  }
  EXPECT_EQ(owner.size(), kPages);
  EXPECT_EQ(divisions.size(), 1U);
  EXPECT_EQ(parts.size(), names.size());
  EXPECT_EQ(*parts.rbegin(), names.size() - 1);
  return owner;
}

TEST(PageShares, EachPageIsOnesAndOnlyThoseOfOneThatGoesMove) {
  const auto three = owners({"relight-1", "relight-2", "relight-3"});
  std::map<std::string, int> count;
  for (const auto& [page, owner] : three) ++count[owner];
  for (const auto& [name, pages] : count) EXPECT_NEAR(pages, kPages / 3, kPages / 20) << name;
  const auto two = owners({"relight-1", "relight-3"});
  for (const auto& [page, owner] : three) {
    EXPECT_TRUE(owner == "relight-2" || two.at(page) == owner) << page;
  }
}

TEST(PageShares, ThoseThatRunShare) {
  PageShares shares("a");
  EXPECT_FALSE(shares.heard());
  EXPECT_TRUE(shares.alone());
  EXPECT_FALSE(take(shares, {{"a"}, {"trainer", "trainer"}}));
  EXPECT_TRUE(shares.heard());
  for (const Seen& other :
       {Seen{.source = "b", .state = wire::ServiceState::Starting}, Seen{.source = "b", .alive = false},
        Seen{.source = "b", .state = wire::ServiceState::Stopping}}) {
    EXPECT_FALSE(take(shares, {other}));
  }
  EXPECT_TRUE(take(shares, {{"c"}, {"b"}}));
  EXPECT_EQ(shares.sources(), (std::vector<std::string>{"a", "b", "c"}));
  const std::uint64_t division = shares.division();
  EXPECT_FALSE(take(shares, {{"b"}, {"c"}, {"a"}}));
  EXPECT_TRUE(take(shares, {{"b"}}));
  EXPECT_NE(shares.division(), division);
}

}  // namespace
}  // namespace splatbus::relight
