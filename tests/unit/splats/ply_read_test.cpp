#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <sstream>
#include <stdexcept>

#include "../gaussians/random.h"
#include "splats/file.h"
#include "splats/ply.h"

namespace splatbus::splats {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::ThrowsMessage;

const std::array<const char*, 14> kRequired = {"x",       "y",       "z",       "f_dc_0", "f_dc_1", "f_dc_2", "opacity",
                                               "scale_0", "scale_1", "scale_2", "rot_0",  "rot_1",  "rot_2",  "rot_3"};

std::string lines(std::initializer_list<std::string> all) {
  std::string text;
  for (const std::string& line : all) text += line + "\n";
  return text;
}

std::string required_properties() {
  std::string text;
  for (const char* name : kRequired) text += fmt::format("property float {}\n", name);
  return text;
}

template <typename T>
std::string bytes(std::initializer_list<T> values) {
  std::string out;
  for (const T& value : values) {
    std::array<char, sizeof(T)> raw{};
    std::memcpy(raw.data(), &value, sizeof value);
    out.append(raw.data(), raw.size());
  }
  return out;
}

/// One row for required_properties().
std::string row(float first) {
  return bytes<float>({first, 2, 3, 0.1F, 0.2F, 0.3F, -1, -4, -5, -6, 1, 0, 0, 0});
}

class ReadPly : public ::testing::Test {
 protected:
  GaussiansBuffer read(const std::string& content) {
    std::istringstream stream(content);
    return read_ply(stream, "model.ply", Axes::Keep).gaussians;
  }
  void expect_refused(const std::string& content, const std::string& reason) {
    EXPECT_THAT([&] { (void)read(content); },
                ThrowsMessage<std::runtime_error>(AllOf(HasSubstr("model.ply: "), HasSubstr(reason))));
  }

  static constexpr const char* kStart = "ply\nformat binary_little_endian 1.0\n";
};

TEST_F(ReadPly, ReadsAnyOrderAndAnyTypeAndSkipsWhatItDoesNotKnow) {
  std::string header =
      lines({"ply", "format binary_little_endian 1.0", "comment made by hand", "obj_info nothing", "element camera 2",
             "property double exposure", "property uchar kind", "element vertex 2", "property uchar red",
             "property double z", "property float rot_3", "property float rot_2", "property float rot_1",
             "property float rot_0", "property ushort segment", "property double x", "property int y"});
  for (const char* name : {"scale_2", "scale_1", "scale_0", "opacity", "f_dc_2", "f_dc_1", "f_dc_0", "confidence"}) {
    header += fmt::format("property float32 {}\n", name);
  }
  header += lines({"element face 1", "property list uchar int vertex_indices", "end_header"});
  std::string content = header;
  for (int i = 0; i < 2; ++i) content += bytes<double>({1e300}) + bytes<std::uint8_t>({7});
  for (int i = 0; i < 2; ++i) {
    content += bytes<std::uint8_t>({200}) + bytes<double>({3.5 + i}) + bytes<float>({0.4F, 0.3F, 0.2F, 0.1F}) +
               bytes<std::uint16_t>({9999}) + bytes<double>({-1.25}) + bytes<std::int32_t>({-2}) +
               bytes<float>({-6, -5, -4, 0.5F, 0.03F, 0.02F, 0.01F, std::nanf("")});
  }
  content += bytes<std::uint8_t>({3}) + bytes<std::int32_t>({0, 1, 1});
  const GaussiansBuffer model = read(content);
  ASSERT_EQ(model.count(), 2U);
  EXPECT_EQ(model.layout(), (ParameterLayout{Appearance::Radiance, 0}));
  const std::array<float, 14> expected = {-1.25F, -2,   4.5F, -4,   -5,    -6,    0.1F,
                                          0.2F,   0.3F, 0.4F, 0.5F, 0.01F, 0.02F, 0.03F};
  for (std::size_t c = 0; c < expected.size(); ++c)
    EXPECT_EQ(model.parameters[c * model.stride() + 1], expected[c]) << c;
}

TEST_F(ReadPly, AcceptsAnEmptyModelAndWindowsLineEnds) {
  EXPECT_EQ(read(kStart + std::string("element vertex 0\n") + required_properties() + "end_header\n").count(), 0U);
  std::string windows;
  for (const char c : kStart + std::string("element vertex 1\n") + required_properties() + "end_header\n") {
    if (c == '\n') windows += '\r';
    windows += c;
  }
  EXPECT_EQ(read(windows + row(1.5F)).parameters[0], 1.5F);
}

TEST_F(ReadPly, RefusesBrokenHeadersByLine) {
  expect_refused("", "line 1: the file ends inside the header");
  expect_refused("PNG\n", "line 1: this is not a PLY file");
  expect_refused("ply\nformat ascii 1.0\n", "line 2: format ascii is not supported");
  expect_refused("ply\nformat binary_big_endian 1.0\n", "line 2: format binary_big_endian is not supported");
  expect_refused("ply\nformat binary_little_endian 2.0\n", "line 2: unknown format");
  expect_refused("ply\nformat\n", "line 2: expected");
  expect_refused(kStart + lines({"element vertex"}), "line 3: expected \"element NAME COUNT\"");
  expect_refused(kStart + lines({"element vertex -1"}), "line 3: \"-1\" is not a number of rows");
  expect_refused(kStart + lines({"element vertex 99999999999999999999999"}), "is not a number of rows");
  expect_refused(kStart + lines({"property float x"}), "line 3: a property before any element");
  expect_refused(kStart + lines({"element vertex 1", "property quad x"}), "line 4: unknown type \"quad\"");
  expect_refused(kStart + lines({"element vertex 1", "property float"}), "line 4: expected");
  expect_refused(kStart + lines({"element vertex 1", "property float x", "property float x"}), "appears twice");
  expect_refused(kStart + lines({"element vertex 1", "element vertex 1"}), "line 4: second element vertex");
  expect_refused(kStart + lines({"element vertex 1", "property list uchar int i"}), "line 4: list properties");
  expect_refused(kStart + lines({"vertices 12"}), "line 3: unknown keyword \"vertices\"");
  expect_refused(kStart + lines({"end_header"}), "there is no element vertex");
  expect_refused("ply\nelement vertex 0\n" + required_properties() + "end_header\n", "names no format");
  expect_refused(kStart + lines({"element face 1", "property list uchar int i", "element vertex 0", "end_header"}),
                 "face comes before vertex and has a list property");
  expect_refused(kStart + std::string(100000, 'c'), "line 3: no end_header in the first 65536 bytes");
}

TEST_F(ReadPly, RefusesMissingProperties) {
  for (const char* missing : kRequired) {
    std::string header = kStart + std::string("element vertex 0\n");
    for (const char* name : kRequired) {
      if (std::string(name) != missing) header += fmt::format("property float {}\n", name);
    }
    expect_refused(header + "end_header\n", fmt::format("no property \"{}\"", missing));
  }
  const std::string start = kStart + std::string("element vertex 0\n") + required_properties();
  expect_refused(start + "property float f_rest_0\nend_header\n", "1 properties f_rest_*");
  std::string gap = start;
  for (int k = 0; k < 9; ++k) gap += fmt::format("property float f_rest_{}\n", k + 1);
  expect_refused(gap + "end_header\n", "no property \"f_rest_0\"");
}

TEST_F(ReadPly, BoundsTheCountByTheFileBeforeItAllocates) {
  const auto header = [](const std::string& count) {
    return kStart + ("element vertex " + count + "\n") + required_properties() + "end_header\n";
  };
  expect_refused(header("2") + row(1), "2 rows of 56 bytes are announced for element vertex, but only 56 bytes follow");
  expect_refused(header("18446744073709551615") + row(1), "only 56 bytes follow");
  expect_refused(header("329406144173384851") + row(1), "only 56 bytes follow");  // 56 times this wraps to 40
  expect_refused(kStart + lines({"element vertex 18446744073709551615", "end_header"}), "no property \"x\"");
  expect_refused(kStart + lines({"element pad 9223372036854775807", "property double a", "element vertex 0"}) +
                     required_properties() + "end_header\n",
                 "announced for element pad");
}

TEST_F(ReadPly, RefusesValuesThatMakeNoSenseByByte) {
  const std::string header = kStart + std::string("element vertex 3\n") + required_properties() + "end_header\n";
  const std::string good = header + row(1) + row(2) + row(3);
  ASSERT_EQ(read(good).count(), 3U);
  const auto with = [&](std::size_t vertex, std::size_t property, float value) {
    std::string content = good;
    std::memcpy(content.data() + header.size() + vertex * 56 + property * 4, &value, sizeof value);
    return content;
  };
  expect_refused(with(1, 0, std::nanf("")), fmt::format("byte {}: vertex 1: x is nan", header.size() + 56));
  expect_refused(with(2, 7, INFINITY), fmt::format("byte {}: vertex 2: scale_0 is inf", header.size() + 112 + 28));
  expect_refused(with(0, 10, 0), fmt::format("byte {}: vertex 0: the rotation has no usable length", header.size()));
  expect_refused(with(0, 10, 3e38F), "no usable length");
}

TEST_F(ReadPly, BelievesTheCommentsAboutTrainingAndAxes) {
  const auto with = [&](const std::string& comments, Axes axes) {
    std::istringstream stream(kStart + comments + "element vertex 1\n" + required_properties() + "end_header\n" +
                              row(1.5F));
    return read_ply(stream, "model.ply", axes);
  };
  EXPECT_FALSE(with("", Axes::OfFormat).mip);
  EXPECT_TRUE(with("comment SplatRenderMode: mip\n", Axes::OfFormat).mip);
  EXPECT_FALSE(with("comment antialiased 1\ncomment splatrendermode: default\n", Axes::OfFormat).mip) << "the last";
  EXPECT_TRUE(with("comment Antialiased 1\n", Axes::OfFormat).mip);
  const auto x = [&](const std::string& comments, Axes axes) { return with(comments, axes).gaussians.parameters[0]; };
  EXPECT_EQ(x("", Axes::OfFormat), -1.5F);
  EXPECT_EQ(x("", Axes::Keep), 1.5F);
  EXPECT_EQ(x("comment SplatAxes: y-up\n", Axes::OfFormat), 1.5F);
  EXPECT_EQ(x("comment SplatAxes: y-up\n", Axes::Turn), -1.5F);
}

TEST_F(ReadPly, SaysWhatACompressedFileIs) {
  expect_refused(kStart + lines({"element chunk 0", "property float min_x", "element vertex 0",
                                 "property uint packed_position", "end_header"}),
                 "a compressed PLY of SuperSplat");
}

TEST_F(ReadPly, RefusesWhatIsNoFile) {
  EXPECT_THAT([] { (void)read_file("/no/such/model.ply"); },
              ThrowsMessage<std::runtime_error>(HasSubstr("/no/such/model.ply: cannot be opened")));
  EXPECT_THROW((void)read_file("/"), std::runtime_error);
}

TEST_F(ReadPly, SurvivesEveryTruncationAndManyMutations) {
  test::Random random(16);
  GaussiansBuffer model = random.gaussians({Appearance::Radiance, 1}, 3);
  model.object_id.assign(3, kWorldFrame);
  std::ostringstream written;
  write_ply(written, BakedModel(model.view(), {}), {});
  const std::string good = written.str();
  for (std::size_t size = 0; size < good.size(); size += 3) {
    EXPECT_THROW((void)read(good.substr(0, size)), std::runtime_error) << size;
  }
  int read_anyway = 0;
  for (int i = 0; i < 1500; ++i) {
    std::string content = good;
    for (int change = 0; change < 1 + i % 4; ++change) {
      const auto place = static_cast<std::size_t>(random.uniform(0, static_cast<float>(content.size()) - 1));
      content[place] = static_cast<char>(random.uniform(0, 255));
    }
    try {
      const GaussiansBuffer survivor = read(content);
      EXPECT_LE(survivor.count(), 3U);
      const auto finite = [](float value) { return std::isfinite(value); };
      EXPECT_TRUE(std::all_of(survivor.parameters.begin(), survivor.parameters.end(), finite));
      ++read_anyway;
    } catch (const std::runtime_error& error) {
      EXPECT_THAT(error.what(), HasSubstr("model.ply: "));
    }
  }
  EXPECT_GT(read_anyway, 50) << "changes within the rows are mostly just other values";
}

}  // namespace
}  // namespace splatbus::splats
