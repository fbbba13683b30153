#include "sim/patterns.h"

#include <array>
#include <cmath>
#include <glm/gtc/constants.hpp>
#include <opencv2/imgproc.hpp>

#include "sim/paint.h"

namespace splatbus::sim {
namespace {

constexpr std::uint32_t kSide = 256;
constexpr std::uint32_t kPageSide = 512;

/// Grain along u: long streaks with finer ones in them.
float grain(std::uint32_t seed, float u, float v) {
  return 0.55F * noise(seed, {u * 4, v * 28}, {4, 28}) + 0.3F * noise(seed + 1, {u * 8, v * 64}, {8, 64}) +
         0.15F * noise(seed + 2, {u * 16, v * 128}, {16, 128});
}

/// Draws with OpenCV on an image of its own, as a coverage in [0, 1].
template <class Draw>
std::vector<float> ink_mask(std::uint32_t side, Draw&& draw) {
  cv::Mat mask(static_cast<int>(side), static_cast<int>(side), CV_8UC1, cv::Scalar(0));
  draw(mask);
  std::vector<float> coverage;
  coverage.reserve(std::size_t{side} * side);
  for (int y = 0; y < mask.rows; ++y) {
    for (int x = 0; x < mask.cols; ++x) coverage.push_back(static_cast<float>(mask.at<std::uint8_t>(y, x)) / 255);
  }
  return coverage;
}

float at(const std::vector<float>& coverage, std::uint32_t side, float u, float v) {
  const auto x = std::min(static_cast<std::uint32_t>(u * static_cast<float>(side)), side - 1);
  const auto y = std::min(static_cast<std::uint32_t>(v * static_cast<float>(side)), side - 1);
  return coverage[std::size_t{y} * side + x];
}

/// Boards of a floor, in rows of four, each of a tone and a grain of its own.
class Planks {
 public:
  explicit Planks(std::uint32_t seed) : seed_(seed) {
    for (int row = 0; row < kRows; ++row) {
      auto& [shift, tones] = rows_.at(static_cast<std::size_t>(row));
      shift = hash01(seed, row, 7) * kLengths;
      for (int index = 0; index < kLengths; ++index) {
        tones.at(static_cast<std::size_t>(index)) = hash01(seed + 5, row, index);
      }
    }
  }

  /// Both in [0, 1).
  [[nodiscard]] glm::vec3 at(float u, float v) const {
    const float row_position = v * kRows;
    const auto row = static_cast<std::uint32_t>(row_position);
    const auto& [shift, tones] = rows_[row];
    const float shifted = u * kLengths + shift;
    const std::uint32_t index = static_cast<std::uint32_t>(shifted) % kLengths;
    const float streak = grain(seed_ + 11 + row * kLengths + index, u * 5, v * 1.5F);
    const bool seam = from_edge(row_position) < 0.03F || from_edge(shifted) < 0.004F;
    const glm::vec3 base = glm::mix(dark_, light_, 0.65F * tones[index] + 0.35F * streak);
    return base * (seam ? 0.35F : 1.0F);
  }

 private:
  static constexpr int kRows = 22;  // across 5 m
  static constexpr int kLengths = 4;
  struct Row {
    float shift = 0;
    std::array<float, kLengths> tones{};
  };
  static float from_edge(float position) {
    const float past = position - static_cast<float>(static_cast<int>(position));
    return std::min(past, 1 - past);
  }

  std::uint32_t seed_;
  glm::vec3 dark_ = color("#8a5a34"), light_ = color("#c89a66");
  std::array<Row, kRows> rows_;
};

/// Concentric patterned bands; `radius` in [0, 1] of the rug's.
glm::vec3 rug(float radius, float angle) {
  static const glm::vec3 navy = color("#2c3e63");
  static const glm::vec3 cream = color("#d9cbb0");
  static const glm::vec3 red = color("#a23b36");
  static const glm::vec3 teal = color("#3f8079");
  const auto petals = [&](int count, float phase) {
    return 0.5F + 0.5F * std::cos(angle * static_cast<float>(count) + phase);
  };
  if (radius > 0.96F) return cream;
  if (radius > 0.90F) return navy;
  if (radius > 0.72F) {  // triangles that point inwards and outwards by turns
    const float turn = angle / glm::two_pi<float>() * 28;
    const float inside = std::abs(turn - std::floor(turn) - 0.5F) * 2;
    return (radius - 0.72F) / 0.18F > inside ? red : cream;
  }
  if (radius > 0.68F) return navy;
  if (radius > 0.50F) return std::abs((radius - 0.59F) / 0.09F) < 0.75F * petals(16, 0) ? cream : teal;
  if (radius > 0.46F) return cream;
  if (radius > 0.28F)
    return (static_cast<int>(std::floor(angle / glm::two_pi<float>() * 20)) + (radius > 0.37F ? 1 : 0)) % 2 == 0
               ? navy
               : cream;
  return radius < 0.10F + 0.14F * petals(8, 0) ? cream : red;
}

}  // namespace

glm::vec3 color(const char* hex) {
  const auto value = static_cast<std::uint32_t>(std::stoul(hex + 1, nullptr, 16));
  glm::vec3 result;
  for (int c = 0; c < 3; ++c) {
    const float s = static_cast<float>((value >> (16 - 8 * c)) & 255U) / 255;
    result[c] = s <= 0.04045F ? s / 12.92F : std::pow((s + 0.055F) / 1.055F, 2.4F);
  }
  return result;
}

Image checker(int squares, const glm::vec3& a, const glm::vec3& b) {
  return paint(kSide, [&](float u, float v) {
    const int x = static_cast<int>(u * static_cast<float>(squares));
    const int y = static_cast<int>(v * static_cast<float>(squares));
    return (x + y) % 2 == 0 ? a : b;
  });
}

Image stripes(std::span<const glm::vec3> colors, int repeats, bool diagonal) {
  return paint(kSide, [&](float u, float v) {
    const float across = (diagonal ? u + v : v) * static_cast<float>(repeats);
    const float turn = across - std::floor(across);
    return colors[std::min(static_cast<std::size_t>(turn * static_cast<float>(colors.size())), colors.size() - 1)];
  });
}

Image dots(int count, const glm::vec3& ground, const glm::vec3& dot, float radius) {
  return paint(kSide, [&](float u, float v) {
    const float y = v * static_cast<float>(count);
    const float x = u * static_cast<float>(count) + (static_cast<int>(y) % 2 == 0 ? 0.0F : 0.5F);
    return glm::length(glm::vec2{x - std::floor(x) - 0.5F, y - std::floor(y) - 0.5F}) < radius ? dot : ground;
  });
}

Image wood(std::uint32_t seed, const glm::vec3& light, const glm::vec3& dark) {
  return paint(kSide, [&](float u, float v) {
    const float bend = noise(seed + 9, {u * 3, v * 3}, {3, 3});
    const float rings = 0.5F + 0.5F * std::sin(glm::two_pi<float>() * (v * 6 + 0.7F * bend));
    const float streak = grain(seed, u, v);
    const bool board_edge = v * 4 - std::floor(v * 4) < 0.035F;
    return glm::mix(light, dark, 0.45F * rings + 0.55F * streak) * (board_edge ? 0.4F : 1.0F);
  });
}

Image gradient(const glm::vec3& top, const glm::vec3& bottom, const glm::vec3& ring, int rings) {
  return paint(kSide, [&](float /*u*/, float v) {
    const float band = v * static_cast<float>(rings);
    return band - std::floor(band) > 0.82F ? ring : glm::mix(top, bottom, v);
  });
}

Image bricks(std::uint32_t seed, int rows, const glm::vec3& brick, const glm::vec3& joint) {
  return paint(kSide, [&](float u, float v) {
    const float y = v * static_cast<float>(rows);
    const int row = static_cast<int>(y);
    const float x = u * static_cast<float>(rows) / 2 + (row % 2 == 0 ? 0.0F : 0.5F);
    const int column = static_cast<int>(x) % (rows / 2);
    const float fx = x - std::floor(x);
    const float fy = y - std::floor(y);
    if (fx < 0.04F || fy < 0.09F) return joint;
    return brick * (0.65F + 0.5F * hash01(seed, column, row)) *
           (0.85F + 0.3F * noise(seed + 3, {u * 40, v * 40}, {40, 40}));
  });
}

Image letter(const std::string& text, const glm::vec3& ground, const glm::vec3& ink) {
  constexpr std::uint32_t kLetterSide = 256;
  const std::vector<float> mask = ink_mask(kLetterSide, [&](cv::Mat& target) {
    cv::rectangle(target, {14, 14}, {242, 242}, cv::Scalar(255), 10, cv::LINE_AA);
    const double scale = text.size() == 1 ? 6.5 : 2.4;
    const int weight = text.size() == 1 ? 22 : 8;
    int baseline = 0;
    const cv::Size size = cv::getTextSize(text, cv::FONT_HERSHEY_SIMPLEX, scale, weight, &baseline);
    cv::putText(target, text, {(256 - size.width) / 2, (256 + size.height) / 2}, cv::FONT_HERSHEY_SIMPLEX, scale,
                cv::Scalar(255), weight, cv::LINE_AA);
  });
  return paint(kLetterSide, [&](float u, float v) { return glm::mix(ground, ink, at(mask, kLetterSide, u, v)); });
}

Image page(std::uint32_t seed, const glm::vec3& paper, const glm::vec3& ink) {
  const std::vector<float> mask = ink_mask(kPageSide, [&](cv::Mat& target) {
    cv::putText(target, "SPLATBUS", {34, 84}, cv::FONT_HERSHEY_DUPLEX, 2.6, cv::Scalar(255), 7, cv::LINE_AA);
    constexpr std::array<const char*, 12> kWords{"light", "of",    "the", "floor", "toys",   "are",
                                                 "seen",  "again", "and", "many",  "colors", "turn"};
    for (int line = 0; line < 8; ++line) {
      std::string text;
      for (int word = 0; word < 4; ++word) {
        text += kWords.at(static_cast<std::size_t>(hash01(seed, line, word) * 11.99F));
        text += ' ';
      }
      cv::putText(target, text, {34, 150 + 46 * line}, cv::FONT_HERSHEY_SIMPLEX, 1.25, cv::Scalar(255), 3, cv::LINE_AA);
    }
    cv::rectangle(target, {6, 6}, {505, 505}, cv::Scalar(255), 8, cv::LINE_AA);
  });
  return paint(kPageSide, [&](float u, float v) { return glm::mix(paper, ink, at(mask, kPageSide, u, v)); });
}

Image floor_with_rug(std::uint32_t seed) {
  constexpr std::uint32_t kFloorSide = 1024;
  constexpr float kRugRadius = 0.29F;  // of the floor's side
  const Planks planks(seed);
  return paint(kFloorSide, [&](float u, float v) {
    const glm::vec2 p{u - 0.5F, v - 0.5F};
    const float radius = glm::length(p) / kRugRadius;
    if (radius >= 1) return planks.at(u, v);
    const float weave = 0.9F + 0.2F * noise(seed + 77, {u * 512, v * 512}, {512, 512});
    return rug(radius, std::atan2(p.y, p.x) + glm::pi<float>()) * weave;
  });
}

}  // namespace splatbus::sim
