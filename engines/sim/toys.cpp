#include "sim/toys.h"

#include <array>
#include <glm/gtc/matrix_transform.hpp>
#include <utility>

#include "sim/living_toys.h"
#include "sim/patterns.h"
#include "sim/random.h"

namespace splatbus::sim {
namespace {

constexpr int kRound = 32;  // segments of a round toy

glm::mat4 at(float x, float y, float z, float turn_deg = 0) {
  return glm::rotate(glm::translate(glm::mat4(1), {x, y, z}), glm::radians(turn_deg), kUp);
}

glm::mat4 tilted(const glm::mat4& placed, float degrees, const glm::vec3& axis) {
  return glm::rotate(placed, glm::radians(degrees), axis);
}

Mesh stairs(int steps, float width, float rise, float run) {
  Mesh mesh;
  for (int i = 0; i < steps; ++i) {
    const float height = rise * static_cast<float>(i + 1);
    const float z = run * (static_cast<float>(i) - 0.5F * static_cast<float>(steps - 1));
    append(mesh, box({width, height, run}, 3), at(0, height / 2, z));
  }
  return mesh;
}

Mesh table(const glm::vec3& size, float leg) {
  Mesh mesh;
  constexpr float kTop = 0.03F;
  append(mesh, box({size.x, kTop, size.z}, 2), at(0, size.y - kTop / 2, 0));
  for (const float x : {-1.0F, 1.0F}) {
    for (const float z : {-1.0F, 1.0F}) {
      append(mesh, box({leg, size.y - kTop, leg}, 2),
             at(x * (size.x / 2 - leg), (size.y - kTop) / 2, z * (size.z / 2 - leg)));
    }
  }
  return mesh;
}

/// Thin rods that lean on one another in a ring.
Mesh tripod(int rods, float radius, float length) {
  Mesh mesh;
  for (int i = 0; i < rods; ++i) {
    const float turn = 360.0F * static_cast<float>(i) / static_cast<float>(rods);
    const glm::mat4 stood = tilted(at(0, 0, 0, turn) * at(0.17F, 0, 0), 22, {0, 0, 1});
    append(mesh, cylinder(radius, length, 8, 1), stood);
  }
  return mesh;
}

/// Rings of falling size on a peg.
Mesh ring_tower(int rings) {
  Mesh mesh;
  float y = 0;
  for (int i = 0; i < rings; ++i) {
    const float tube = 0.055F - 0.006F * static_cast<float>(i);
    append(mesh, torus(0.14F - 0.02F * static_cast<float>(i), tube, 22, 9, 3), at(0, y + tube, 0));
    y += 1.85F * tube;
  }
  append(mesh, cylinder(0.022F, y + 0.05F, 12, 1));
  return mesh;
}

Mesh vase() {
  return lathe(std::array<glm::vec2, 10>{{{0, 0},
                                          {0.10F, 0},
                                          {0.15F, 0.09F},
                                          {0.165F, 0.17F},
                                          {0.15F, 0.25F},
                                          {0.10F, 0.34F},
                                          {0.065F, 0.41F},
                                          {0.07F, 0.46F},
                                          {0.10F, 0.50F},
                                          {0, 0.47F}}},
               kRound, 2);
}

Mesh arch(float width, float height, float depth) {
  Mesh mesh;
  const float post = width * 0.22F;
  append(mesh, box({post, height * 0.72F, depth}, 3), at(-(width - post) / 2, height * 0.36F, 0));
  append(mesh, box({post, height * 0.72F, depth}, 3), at((width - post) / 2, height * 0.36F, 0));
  append(mesh, box({width, height * 0.28F, depth}, 3), at(0, height * 0.86F, 0));
  return mesh;
}

class Builder {
 public:
  explicit Builder(std::uint32_t seed) : seed_(seed) {}

  /// Places a toy, shifted and turned a little by the seed about its own place.
  void add(const char* name, Mesh mesh, Image image, const glm::mat4& place) {
    const auto id = static_cast<std::uint32_t>(scene.objects.size() + 1);
    const glm::vec3 shift{0.04F * (random01(seed_, id, 1) - 0.5F), 0, 0.04F * (random01(seed_, id, 2) - 0.5F)};
    const float turn = glm::radians(16 * (random01(seed_, id, 3) - 0.5F));
    // Whoever leans on or lies in another toy moves with it.
    const glm::vec3 origin = glm::vec3(place[3]);
    glm::mat4 jitter = glm::translate(glm::mat4(1), shift + origin);
    jitter = glm::translate(glm::rotate(jitter, turn, kUp), -origin);
    last_jitter_ = jitter;
    scene.add(name, std::move(mesh), std::move(image), jitter * place);
  }
  void add_with_last(const char* name, Mesh mesh, Image image, const glm::mat4& place) {
    scene.add(name, std::move(mesh), std::move(image), last_jitter_ * place);
  }
  Scene scene;

 private:
  std::uint32_t seed_;
  glm::mat4 last_jitter_{1};
};

void add_inner_toys(Builder& toys, std::uint32_t seed) {
  toys.add("ball", sphere(0.30F, kRound, 2), dots(6, color("#d8443c"), color("#e6dfcf"), 0.3F),
           at(0.12F, 0.30F, -0.15F, 20));
  toys.add("crate", box({0.46F, 0.46F, 0.46F}), wood(seed + 1, color("#c99a5b"), color("#7d4f28")),
           at(-0.62F, 0.23F, -0.42F, 28));
  toys.add_with_last("crate ball", sphere(0.13F, 24, 2), checker(8, color("#2f6fae"), color("#dfe3e6")),
                     at(-0.62F, 0.59F, -0.42F));
  toys.add_with_last("hoop", torus(0.30F, 0.022F, 36, 7, 8),
                     stripes(std::array{color("#e3b83a"), color("#4a3a86")}, 1, false),
                     tilted(at(-0.40F, 0.30F, -0.08F, 28), 73, {1, 0, 0}));
  toys.add("torus", torus(0.25F, 0.085F, 32, 14, 3), checker(6, color("#3d9a5f"), color("#d8dcae")),
           at(0.62F, 0.085F, 0.42F));
  toys.add("cone", cone(0.22F, 0.62F, kRound, 3),
           stripes(std::array{color("#e07b2c"), color("#e9dcc3"), color("#8f3f1e")}, 3, true), at(-0.18F, 0, 0.62F));
  toys.add("pyramid", pyramid(0.46F, 0.42F), bricks(seed + 2, 8, color("#c2a05a"), color("#6d5a3a")),
           at(0.75F, 0, -0.35F, 25));
  toys.add("cylinder", cylinder(0.15F, 0.52F, kRound, 2),
           stripes(std::array{color("#3a75b5"), color("#e0d9c5"), color("#b53a55"), color("#e0d9c5")}, 2, false),
           at(0.28F, 0, -0.78F));
}

void add_outer_toys(Builder& toys, std::uint32_t seed) {
  toys.add("table", table({0.74F, 0.48F, 0.46F}, 0.03F), wood(seed + 3, color("#b4764a"), color("#5e3520")),
           at(-1.25F, 0, 0.45F, 62));
  toys.add_with_last("vase", vase(), gradient(color("#5fb0b7"), color("#27496d"), color("#e6d9a8"), 7),
                     at(-1.22F, 0.48F, 0.38F));
  toys.add("stairs", stairs(5, 0.42F, 0.085F, 0.13F), bricks(seed + 4, 6, color("#b5665a"), color("#cfc4b5")),
           at(1.30F, 0, 0.32F, 105));
  toys.add("ring tower", ring_tower(5),
           stripes(std::array{color("#d6453d"), color("#e8b23c"), color("#3c8fd6")}, 2, true), at(0.42F, 0, 1.12F));
  toys.add("capsule", capsule(0.11F, 0.34F, 26, 3), dots(5, color("#7a55a8"), color("#e5c94f"), 0.28F),
           tilted(at(-0.75F, 0.11F, 1.02F, 35), 90, {0, 0, 1}));
  toys.add("rods", tripod(5, 0.013F, 0.72F), stripes(std::array{color("#c8c1b1"), color("#40484f")}, 9, false),
           at(1.12F, 0, -1.02F));
  toys.add("board", box({0.60F, 0.62F, 0.018F}), page(seed + 5, color("#e4dfd0"), color("#23324d")),
           tilted(at(-0.35F, 0.305F, -1.32F, 12), -9, {1, 0, 0}));
  toys.add("arch", arch(0.62F, 0.52F, 0.16F), bricks(seed + 6, 10, color("#8d9aa8"), color("#4a4f57")),
           at(-1.42F, 0, -0.72F, 70));
  toys.add("plate", cylinder(0.24F, 0.05F, kRound, 1), checker(10, color("#d9cdb4"), color("#4d7f86")),
           at(1.02F, 0, 1.08F));
  toys.add_with_last("fruit", sphere(0.105F, 22, 1), gradient(color("#d8c23a"), color("#c0562a"), color("#8b8f2e"), 4),
                     at(1.07F, 0.145F, 1.06F));
  toys.add_with_last("second fruit", sphere(0.075F, 18, 1), dots(9, color("#b8323c"), color("#dfb08a"), 0.14F),
                     at(0.91F, 0.12F, 1.13F));

  const auto block = [&](const char* text, const char* ground, const char* ink) {
    return letter(text, color(ground), color(ink));
  };
  toys.add("block S", box({0.2F, 0.2F, 0.2F}), block("S", "#ddd2ba", "#b33a3a"), at(-0.10F, 0.10F, 1.42F, 8));
  toys.add_with_last("block P", box({0.2F, 0.2F, 0.2F}), block("P", "#d2d9c4", "#2d6a4f"), at(0.12F, 0.10F, 1.43F, -6));
  toys.add_with_last("block B", box({0.2F, 0.2F, 0.2F}), block("B", "#cfd6de", "#2b4f8c"), at(0.0F, 0.30F, 1.42F, 15));
  toys.add("prism", box({0.9F, 0.10F, 0.13F}, 4), checker(4, color("#e0a832"), color("#41506b")),
           at(0.45F, 0.05F, -1.55F, -14));
}

}  // namespace

Scene make_toys(std::uint32_t seed, bool dynamics) {
  Builder toys(seed);
  toys.scene.add("floor", box({5, 0.04F, 5}), floor_with_rug(seed), at(0, -0.02F, 0)).casts_shadow = false;
  toys.scene.materials.back().repeat = false;
  add_inner_toys(toys, seed);
  add_outer_toys(toys, seed);
  if (dynamics) add_living_toys(toys.scene);
  return std::move(toys.scene);
}

}  // namespace splatbus::sim
