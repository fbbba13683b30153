// Thousands of mutated files, the same ones in every run: each is read, or refused with its name and a reason, and what
// is read can be drawn. Sanitizers tell when a byte is read that is not there.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <iterator>
#include <random>
#include <sstream>
#include <string>

#include "mutate.h"
#include "splats/ply.h"
#include "splats/spz.h"

namespace splatbus::splats {
namespace {

constexpr int kMutations = 4000;
constexpr std::size_t kHeaderBytes = 130;  // of a .ply; it covers those of .spz

std::string bytes_of(const std::string& name) {
  std::ifstream file(std::string(SPLATBUS_SOURCE_DIR "/tests/golden/splats/") + name, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

/// Whether it was read.
bool survives(const std::string& content) {
  std::istringstream stream(content);
  try {
    const bool spz = !content.empty() && is_spz(static_cast<unsigned char>(content[0]));
    const SplatFile file = spz ? read_spz(stream, "mutant", Axes::Turn) : read_ply(stream, "mutant", Axes::OfFormat);
    EXPECT_LE(file.gaussians.count(), std::max<std::size_t>(64 * content.size(), 1U << 20U) / 19);
    for (const float value : file.gaussians.parameters) {
      if (!std::isfinite(value)) ADD_FAILURE() << "a parameter of " << value;
    }
    return true;
  } catch (const std::runtime_error& error) {
    EXPECT_EQ(std::string(error.what()).rfind("mutant: ", 0), 0U) << error.what();
    return false;
  }
}

TEST(SplatFileMutation, IsReadOrRefused) {
  std::mt19937_64 random(2026);
  for (const char* name : {"given.ply", "splat_transform3.spz", "splat_transform4.spz"}) {
    const std::string good = bytes_of(name);
    ASSERT_TRUE(survives(good)) << name;
    for (std::size_t size = 0; size < good.size(); size += 7) EXPECT_FALSE(survives(good.substr(0, size))) << name;
    int read = 0;
    for (int i = 0; i < kMutations; ++i) read += survives(fuzz::mutate(good, random, kHeaderBytes)) ? 1 : 0;
    EXPECT_GT(read, kMutations / 400) << name << ": nothing behind the header was reached";
    EXPECT_LT(read, kMutations) << name;
  }
}

/// Under gzip nearly every change is one that zlib sees; so the plain bytes are changed, and packed without
/// compression.
std::string stored_gzip(const std::string& plain) {
  std::string out("\x1f\x8b\x08\x00\x00\x00\x00\x00\x00\x03\x01", 11);
  const auto length = static_cast<std::uint16_t>(plain.size()), inverse = static_cast<std::uint16_t>(~length);
  out.append(reinterpret_cast<const char*>(&length), 2).append(reinterpret_cast<const char*>(&inverse), 2);
  return out + plain;  // no sum: what was read is refused at the very end, which is what is tried here
}

TEST(SplatFileMutation, Version3IsReadOrRefusedBehindItsCompression) {
  std::mt19937_64 random(2027);
  std::string plain("NGSP\x03\x00\x00\x00\x04\x00\x00\x00\x01\x0C\x01\x00", 16);
  for (int i = 0; i < 4 * 29; ++i) plain += static_cast<char>(random());
  for (int i = 0; i < kMutations; ++i) EXPECT_FALSE(survives(stored_gzip(fuzz::mutate(plain, random, kHeaderBytes))));
}

}  // namespace
}  // namespace splatbus::splats
