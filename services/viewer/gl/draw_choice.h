#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace splatbus::viewer::gl {

/// How splats come to the picture: as quads that the rasteriser of the device blends, or tile by tile in compute.
enum class Way : std::uint8_t { Quads, Tiles };
inline constexpr std::size_t kWays = 2;

/// What is asked for.
enum class Draw : std::uint8_t { Auto, Quads, Tiles };

/// Which way is the faster: a few pictures of each are timed on the device at hand, at the start and whenever the model
/// is four times as large, or as small, as when that was done last.
class DrawChoice {
 public:
  explicit DrawChoice(Draw draw = Draw::Auto);

  /// That the next picture, of so many rows, is to go.
  [[nodiscard]] Way next(std::size_t rows);
  /// The number of the trial that is under way, for took(); 0: none is.
  [[nodiscard]] unsigned trial() const { return trying_ ? trial_ : 0; }
  /// What a picture of a trial has cost; of another trial than the one under way it says nothing.
  void took(unsigned trial, Way way, double ms);
  /// What was timed of the trial under way was not what it seemed.
  void try_again();
  /// The number of the last trial that has come to an end; 0: none has.
  [[nodiscard]] unsigned decided() const { return decided_; }
  [[nodiscard]] Way chosen() const { return chosen_; }
  /// Median of that trial, ms.
  [[nodiscard]] double cost_ms(Way way) const { return cost_ms_[static_cast<std::size_t>(way)]; }

 private:
  void begin_trial();

  Draw draw_;
  Way chosen_ = Way::Quads;
  bool trying_ = false;
  unsigned trial_ = 0, decided_ = 0;
  std::size_t tried_rows_ = 0;
  std::array<std::size_t, kWays> begun_{};
  std::array<std::vector<double>, kWays> times_ms_;
  std::array<double, kWays> cost_ms_{};
};

}  // namespace splatbus::viewer::gl
