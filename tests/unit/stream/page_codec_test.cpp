#include "stream/page_codec.h"

#include <gtest/gtest.h>
#include <hwy/targets.h>

#include <cmath>
#include <fstream>
#include <iterator>
#include <numeric>
#include <random>

#include "quantize_once.h"
#include "stream/page_precision.h"
#include "toy_model.h"

namespace splatbus::stream {
namespace {

struct Page {
  StreamLayout layout;
  QuantizedGaussians gaussians;
};

Page toy_page(std::size_t count, Appearance appearance = Appearance::Transfer, int degree = 3) {
  const GaussiansBuffer model = test::toy_model(count, 3, 100, appearance, degree);
  Page page{StreamLayout(model.layout(), test::choose_mean_step(model.view()) / 4), {}};
  page.gaussians = test::quantize_once(model.view(), page.layout).gaussians;
  return page;
}

/// Every value anywhere within its limits.
Page random_page(std::size_t count, std::uint32_t seed, Appearance appearance = Appearance::Radiance, int degree = 3) {
  Page page{StreamLayout({appearance, degree}, 1.0F / 1024), {}};
  page.gaussians = QuantizedGaussians(page.layout, count);
  std::mt19937_64 random(seed);
  for (const AttributeChannels& a : page.layout.attributes()) {
    for (int c = 0; c < a.channels; ++c) {
      std::uniform_int_distribution<std::int32_t> any(a.minimum, a.maximum);
      for (std::int32_t& value : page.gaussians.channels[a.first + c]) value = any(random);
    }
  }
  for (std::uint32_t& id : page.gaussians.object_id) id = static_cast<std::uint32_t>(random());
  for (std::uint64_t& id : page.gaussians.gaussian_id) id = random();
  return page;
}

QuantizedGaussians without_ids(QuantizedGaussians page) {
  std::ranges::fill(page.gaussian_id, 0);
  return page;
}

void expect_lossless(const Page& page, PageCodec codec) {
  const std::size_t count = page.gaussians.count();
  for (const bool ids : {true, false}) {
    const PageBlob blob =
        encode_page(page.gaussians, page.layout, codec, {.ids = ids, .keep_order = false, .origin = {}});
    std::vector<std::uint32_t> sorted = blob.order;
    std::ranges::sort(sorted);
    std::vector<std::uint32_t> all(count);
    std::iota(all.begin(), all.end(), 0U);
    ASSERT_EQ(sorted, all);
    const QuantizedGaussians lanes = page.gaussians.gather(blob.order);
    const QuantizedGaussians decoded = decode_page(blob.bytes, page.layout, codec, count);
    for (const AttributeChannels& a : page.layout.attributes()) {
      for (int c = 0; c < a.channels; ++c) {
        ASSERT_EQ(decoded.channels[a.first + c], lanes.channels[a.first + c]) << EnumNameAttribute(a.attribute) << c;
      }
    }
    EXPECT_EQ(decoded, ids ? lanes : without_ids(lanes));
  }
}

class PageCodecs : public testing::TestWithParam<PageCodec> {};

TEST_P(PageCodecs, AreLosslessForTrainedPagesOfEveryAppearance) {
  for (const std::size_t count : {1, 2, 7, 8, 9, 255, 256, 1024, 4096}) {
    expect_lossless(toy_page(count), GetParam());
    expect_lossless(toy_page(count, Appearance::Radiance, 0), GetParam());
    expect_lossless(toy_page(count, Appearance::Radiance, 3), GetParam());
  }
}

TEST_P(PageCodecs, AreLosslessForRoundedPages) {
  for (const float coarseness : {-20.0F, 0.0F, 2.5F, 5.0F, 40.0F}) {
    Page page = toy_page(1000);
    Precision(page.layout, coarseness).round(page.gaussians);
    expect_lossless(page, GetParam());
    page = toy_page(300, Appearance::Radiance, 2);
    Precision(page.layout, coarseness).round(page.gaussians);
    expect_lossless(page, GetParam());
  }
}

TEST_P(PageCodecs, KeepWhateverOrderTheColumnsHave) {
  Page page = toy_page(1000);
  page.gaussians = page.gaussians.gather(page_order(page.gaussians, page.layout, GetParam()));
  std::mt19937 random(8);
  const auto bytes_of = [&](const QuantizedGaussians& columns) {
    const PageBlob blob =
        encode_page(columns, page.layout, GetParam(), {.ids = true, .keep_order = true, .origin = {}});
    EXPECT_TRUE(std::ranges::is_sorted(blob.order));
    EXPECT_EQ(decode_page(blob.bytes, page.layout, GetParam(), columns.count()), columns);
    return static_cast<double>(blob.bytes.size());
  };
  const double sorted = bytes_of(page.gaussians);
  EXPECT_EQ(sorted, static_cast<double>(encode_page(page.gaussians, page.layout, GetParam()).bytes.size()))
      << "the codec's own order costs nothing";
  std::vector<std::uint32_t> columns(1000);
  std::iota(columns.begin(), columns.end(), 0U);
  for (int k = 0; k < 20; ++k) std::swap(columns[random() % 1000], columns[random() % 1000]);
  EXPECT_LT(bytes_of(page.gaussians.gather(columns)), 1.2 * sorted);
  std::ranges::shuffle(columns, random);
  static_cast<void>(bytes_of(page.gaussians.gather(columns)));
}

TEST(PlanesCodec, PartsOfASortedPageAreSortedWhereTheyCountFromItsOrigin) {
  Page page = toy_page(1024);
  page.gaussians = page.gaussians.gather(page_order(page.gaussians, page.layout, PageCodec::Planes));
  for (std::uint32_t first = 0; first < 1024; first += 256) {
    std::vector<std::uint32_t> columns(256);
    std::iota(columns.begin(), columns.end(), first);
    const QuantizedGaussians part = page.gaussians.gather(columns);
    const PageOptions free{.ids = false, .keep_order = false, .origin = mean_origin(page.gaussians, page.layout)};
    PageOptions kept = free;
    kept.keep_order = true;
    const PageBlob a = encode_page(part, page.layout, PageCodec::Planes, free);
    EXPECT_TRUE(std::ranges::is_sorted(a.order));
    EXPECT_EQ(a.bytes, encode_page(part, page.layout, PageCodec::Planes, kept).bytes);
  }
}

// Draco takes seconds for values that are all over their range; what it does with extremes is tested by the chunk.
TEST(PlanesCodec, IsLosslessWhateverTheValues) {
  for (std::uint32_t seed = 0; seed < 8; ++seed) {
    expect_lossless(random_page(seed * 37 + 1, seed), PageCodec::Planes);
    expect_lossless(random_page(seed * 37 + 1, seed, Appearance::Transfer), PageCodec::Planes);
  }
}

TEST(PlanesCodec, IsTheSameOnEveryInstructionSet) {
  std::vector<Page> pages{toy_page(1000), random_page(77, 5), toy_page(4096, Appearance::Radiance, 1)};
  Precision(pages[0].layout, 3).round(pages[0].gaussians);
  const auto code = [&] {
    std::vector<std::pair<Bytes, QuantizedGaussians>> out;
    for (const Page& page : pages) {
      const Bytes bytes = encode_page(page.gaussians, page.layout, PageCodec::Planes).bytes;
      out.emplace_back(bytes, decode_page(bytes, page.layout, PageCodec::Planes, page.gaussians.count()));
    }
    return out;
  };
  const auto best = code();
  for (const std::int64_t target : {std::int64_t{HWY_AVX3}, std::int64_t{HWY_AVX2}, std::int64_t{HWY_SCALAR}}) {
    if (target != HWY_SCALAR && (hwy::SupportedTargets() & target) == 0) continue;
    // The chosen one is forgotten so that the next call chooses again.
    hwy::SetSupportedTargetsForTest(target | HWY_SCALAR);
    hwy::GetChosenTarget().DeInit();
    EXPECT_EQ(code(), best) << hwy::TargetName(target);
    hwy::SetSupportedTargetsForTest(0);
    hwy::GetChosenTarget().DeInit();
  }
}

TEST_P(PageCodecs, AreLosslessAtTheExtremes) {
  Page page = toy_page(100);
  for (const AttributeChannels& a : page.layout.attributes()) {
    for (int c = 0; c < a.channels; ++c) {
      page.gaussians.channels[a.first + c][3] = a.minimum;
      page.gaussians.channels[a.first + c][50] = a.maximum;
    }
  }
  page.gaussians.object_id[9] = 0xFFFFFFFFU;
  page.gaussians.gaussian_id[9] = ~std::uint64_t{0};
  page.gaussians.gaussian_id[20] = page.gaussians.gaussian_id[19] + (std::uint64_t{1} << 63U);
  expect_lossless(page, GetParam());
  // All of them one and the same, so that nothing is left to code.
  expect_lossless({page.layout, page.gaussians.gather(std::vector<std::uint32_t>(500, 20))}, GetParam());
}

TEST_P(PageCodecs, AnEmptyPageHasNoBytes) {
  const Page page = toy_page(0);
  const PageBlob blob = encode_page(page.gaussians, page.layout, GetParam());
  EXPECT_TRUE(blob.bytes.empty());
  EXPECT_EQ(decode_page(blob.bytes, page.layout, GetParam(), 0), page.gaussians);
  EXPECT_THROW((void)decode_page(Bytes{0}, page.layout, GetParam(), 0), StreamError);
}

TEST_P(PageCodecs, RefuseAnotherCountOrLayout) {
  const Page page = toy_page(64);
  const Bytes bytes = encode_page(page.gaussians, page.layout, GetParam()).bytes;
  for (const std::size_t count : {std::size_t{0}, std::size_t{1}, std::size_t{63}, std::size_t{65}, std::size_t{4096},
                                  kMaxPageGaussians + 1, ~std::size_t{0}}) {
    EXPECT_THROW((void)decode_page(bytes, page.layout, GetParam(), count), StreamError) << count;
  }
  const StreamLayout other({Appearance::Radiance, 1}, 1.0F);
  EXPECT_THROW((void)decode_page(bytes, other, GetParam(), 64), StreamError);
  EXPECT_THROW((void)decode_page({}, page.layout, GetParam(), 64), StreamError);
}

TEST_P(PageCodecs, RefuseEveryBeginningAndEveryContinuation) {
  const Page page = toy_page(24, Appearance::Radiance, 1);
  Bytes bytes = encode_page(page.gaussians, page.layout, GetParam()).bytes;
  for (std::size_t size = 0; size < bytes.size(); ++size) {
    EXPECT_THROW((void)decode_page(std::span(bytes).first(size), page.layout, GetParam(), 24), StreamError) << size;
  }
  bytes.push_back(0);
  EXPECT_THROW((void)decode_page(bytes, page.layout, GetParam(), 24), StreamError);
  bytes.resize(64U << 20U);
  EXPECT_THROW((void)decode_page(bytes, page.layout, GetParam(), 24), StreamError);
}

/// What comes back of a mutated blob is within the layout's limits, or nothing does.
void survive_mutations(const Page& page, PageCodec codec, int rounds, std::uint32_t seed, bool keep_order = false) {
  const std::size_t count = page.gaussians.count();
  const PageOptions options{.ids = true, .keep_order = keep_order, .origin = {}};
  const Bytes bytes = encode_page(page.gaussians, page.layout, codec, options).bytes;
  std::mt19937 random(seed);
  const auto below = [&](std::size_t n) { return random() % n; };
  for (int round = 0; round < rounds; ++round) {
    Bytes mutant = bytes;
    // Half of them where the planes are described, which is in the beginning.
    const std::size_t reach = round % 2 == 0 ? std::min<std::size_t>(mutant.size(), 160) : mutant.size();
    for (std::size_t k = 1 + below(4); k > 0; --k) {
      std::uint8_t& byte = mutant[below(reach)];
      byte = below(2) == 0 ? static_cast<std::uint8_t>(random()) : static_cast<std::uint8_t>(byte ^ 1U << below(8));
    }
    if (below(8) == 0) mutant.resize(below(mutant.size()));
    try {
      const QuantizedGaussians out = decode_page(mutant, page.layout, codec, count);
      ASSERT_EQ(out.count(), count);
      for (const AttributeChannels& a : page.layout.attributes()) {
        for (int c = 0; c < a.channels; ++c) {
          ASSERT_EQ(out.channels[a.first + c].size(), count);
          for (const std::int32_t value : out.channels[a.first + c]) {
            ASSERT_TRUE(value >= a.minimum && value <= a.maximum);
          }
        }
      }
    } catch (const StreamError&) {  // as it should
    }
  }
}

TEST(PageCodecHostile, MutatedPlanesAreRefusedOrHarmless) {
  Page page = toy_page(40, Appearance::Radiance, 1);
  survive_mutations(page, PageCodec::Planes, 8000, 1);
  Precision(page.layout, 3).round(page.gaussians);
  survive_mutations(page, PageCodec::Planes, 8000, 2);
  survive_mutations(random_page(5, 3), PageCodec::Planes, 4000, 3);
  survive_mutations(page, PageCodec::Planes, 4000, 5, true);
}

TEST(PageCodecHostile, MutatedDracoPagesAreRefusedOrHarmless) {
  survive_mutations(toy_page(40, Appearance::Radiance, 1), PageCodec::Draco, 2000, 4);
}

INSTANTIATE_TEST_SUITE_P(Both, PageCodecs, testing::Values(PageCodec::Draco, PageCodec::Planes),
                         [](const auto& test) { return test.param == PageCodec::Draco ? "Draco" : "Planes"; });

TEST(PageCodec, AnUnknownCodecIsRefused) {
  EXPECT_TRUE(is_page_codec(1));
  EXPECT_FALSE(is_page_codec(2));
  const Page page = toy_page(1);
  EXPECT_THROW((void)decode_page(Bytes{1}, page.layout, static_cast<PageCodec>(2), 1), StreamError);
}

TEST(PageCodec, PlanesTakeFewerBytesThanDraco) {
  for (const Appearance appearance : {Appearance::Transfer, Appearance::Radiance}) {
    Page page = toy_page(1024, appearance);
    const auto bytes = [&](PageCodec codec) { return encode_page(page.gaussians, page.layout, codec).bytes.size(); };
    EXPECT_LT(bytes(PageCodec::Planes), bytes(PageCodec::Draco));
    const std::size_t unrounded = bytes(PageCodec::Planes);
    Precision(page.layout, 3).round(page.gaussians);
    EXPECT_LT(bytes(PageCodec::Planes), 0.9 * static_cast<double>(unrounded));
  }
}

/// Integers that no library has a part in; read_planes.py has them, too.
Page golden_page(const ParameterLayout& parameters) {
  Page page{StreamLayout(parameters, 1.0F / 4096), {}};
  page.gaussians = QuantizedGaussians(page.layout, 333);
  std::uint32_t state = 12345;
  const auto next = [&](std::uint32_t below) {
    state = state * 1664525U + 1013904223U;
    return static_cast<std::int32_t>((state >> 8U) % below);
  };
  for (std::size_t i = 0; i < page.gaussians.count(); ++i) {
    for (const AttributeChannels& a : page.layout.attributes()) {
      for (int c = 0; c < a.channels; ++c) {
        std::int32_t value = next(7) == 0 ? next(200) - 100 : next(20) - 10;
        if (a.attribute == Attribute::Mean) value = next(3000) - 1500;
        if (a.attribute == Attribute::LogScale) value -= 200 + next(100);
        if (a.attribute == Attribute::Opacity) value = 255 - next(120);
        if (a.attribute == Attribute::Visibility) value = std::abs(value);
        page.gaussians.channels[a.first + c][i] = value;
      }
    }
    page.gaussians.object_id[i] = i < 100 ? 0 : 17;
    page.gaussians.gaussian_id[i] = 1'000'000 + 3 * i;
  }
  return page;
}

/// Golden blobs are what was once sent: they stay readable, whatever the encoder has learnt since.
void expect_golden_is_read(const Page& page, const std::string& name, const PageOptions& options) {
  const std::string path = std::string(SPLATBUS_PAGE_GOLDEN) + "/" + name;
  if (std::getenv("SPLATBUS_UPDATE_GOLDEN") != nullptr) {
    const Bytes bytes = encode_page(page.gaussians, page.layout, PageCodec::Planes, options).bytes;
    std::ofstream(path, std::ios::binary)
        .write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
  }
  std::ifstream file(path, std::ios::binary);
  ASSERT_TRUE(file) << path;
  const Bytes bytes(std::istreambuf_iterator<char>(file), {});
  const QuantizedGaussians read = decode_page(bytes, page.layout, PageCodec::Planes, page.gaussians.count());
  std::vector<std::uint32_t> order;
  if (options.keep_order) {
    EXPECT_EQ(read, page.gaussians) << name;
    return;
  }
  for (const std::uint64_t id : read.gaussian_id) order.push_back(static_cast<std::uint32_t>((id - 1'000'000) / 3));
  ASSERT_TRUE(std::ranges::all_of(order, [&](std::uint32_t i) { return i < page.gaussians.count(); }));
  EXPECT_EQ(read, page.gaussians.gather(order)) << name;
}

TEST(PageCodec, GoldenBlobsAreRead) {
  Page page = golden_page({Appearance::Radiance, 1});
  expect_golden_is_read(page, "planes.bin", {});
  Precision(page.layout, 4).round(page.gaussians);
  expect_golden_is_read(page, "planes_rounded.bin", {});
  page = golden_page({Appearance::Transfer, 3});
  Precision(page.layout, 4).round(page.gaussians);
  std::vector<std::uint32_t> columns;
  for (std::uint32_t i = 0; i < page.gaussians.count(); ++i) columns.push_back(7 * i % 333);
  page.gaussians = page.gaussians.gather(columns);
  expect_golden_is_read(page, "planes_transfer.bin", {.ids = true, .keep_order = true, .origin = {}});
}

TEST(PagePrecision, RoundingTwiceIsRoundingOnce) {
  Page page = toy_page(500);
  Precision(page.layout, 2.5F).round(page.gaussians);
  const QuantizedGaussians once = page.gaussians;
  Precision(page.layout, 2.5F).round(page.gaussians);
  // Rounding moves what the class follows from, now and then across a border: then to a neighbouring class.
  std::size_t moved = 0;
  for (std::size_t c = 0; c < once.channels.size(); ++c) {
    for (std::size_t i = 0; i < once.count(); ++i)
      moved += once.channels[c][i] != page.gaussians.channels[c][i] ? 1 : 0;
  }
  EXPECT_LT(moved, once.channels.size() * once.count() / 10);
}

TEST(PagePrecision, WhatShowsLessIsCoarser) {
  Page page = toy_page(2);
  QuantizedGaussians& g = page.gaussians;
  const auto opacity = static_cast<std::size_t>(page.layout.at(Attribute::Opacity).first);
  const auto albedo = static_cast<std::size_t>(page.layout.at(Attribute::Albedo).first);
  for (auto& plane : g.channels) plane[1] = plane[0];
  g.channels[opacity] = {255, 8};
  g.channels[albedo] = {77, 77};
  Precision(page.layout, 3).round(g);
  EXPECT_LE(std::abs(g.channels[albedo][0] - 77), 4);
  EXPECT_NE(g.channels[albedo][1], 77);
  EXPECT_LE(std::abs(g.channels[albedo][1] - 77), 32);
}

}  // namespace
}  // namespace splatbus::stream
