#include "bench/roofline.h"

#include <algorithm>

#include "fmt/core.h"

namespace splatbus::bench {
namespace {

constexpr double kFloat = 4;
constexpr int kGeometry = ParameterLayout::kAppearance;  // channels
constexpr int kMean = ParameterLayout::kLogScale - ParameterLayout::kMean;
constexpr double kKey = 8, kEntry = 4;  // of a pair: tile and depth in one word; the Gaussian's number

/// What a device needs for what is no multiply-add.
struct Costs {
  double exponential;  // operations
  bool sums;           // over pixels count
};
constexpr Costs kCuda{.exponential = 1, .sums = false};
// Rounding, remainder, a polynomial of degree five, scaling.
constexpr Costs kCpu{.exponential = 8, .sums = true};

// Operations of the formulas in raster/rasterizer.h and gaussians/layout.h.
//
// Of a Gaussian: rotation from a quaternion (9 to normalise, 24), its product with the scale (9, three exponentials),
// opacity (2, one).
constexpr double kShape = 44, kShapeExponentials = 4;
// Of a record: mean in the camera's frame (9), and whether it lies before the near plane (1) ...
constexpr double kPlace = 10;
// ... perspective (9), J W (14), J W R S (18), covariance (11), determinants (12), opacity (3, a logarithm), whitening
// (8), extent (10).
constexpr double kProject = 85, kProjectExponentials = 1;
// Of a pixel and a Gaussian: offset (2), u and v (3), exponent (2), clamp (1), test (1); an exponential.
constexpr double kAlpha = 9, kAlphaExponentials = 1;
// Weight, transmittance, test.
constexpr double kComposite = 3;
// Of dL/d(ln alpha): what lies behind (1), 1 / (1 - alpha) (2), the difference (2), clamp (1).
constexpr double kAlphaGradient = 6;
// Sums of s, s dx, s dy, s dx dx, s dx dy, s dy dy.
constexpr double kMoments = 8;
// Of a pixel and a colour: three products, five blurs forward and three backward of two times 11 taps, SSIM and its
// derivatives (25), what the gradient gathers (8); and the sRGB curve and its slope.
constexpr double kLoss = 3 + 8 * 22 + 25 + 8, kCurve = 8, kCurveExponentials = 4;
// Of a channel: two moments (5), their corrected quotient (6), the step (1).
constexpr double kAdam = 12;

class Model {
 public:
  Model(const Job& job, const Costs& costs)
      : c_(job.census),
        costs_(costs),
        transfer_(job.layout.appearance == Appearance::Transfer),
        albedo_(transfer_ && job.albedo),
        channels_(job.layout.channels()),
        active_(job.active_channels > 0 ? std::min(job.active_channels, channels_) : channels_),
        coefficients_(transfer_ ? 9 : job.layout.sh_coefficients()) {}

  /// Means of all Gaussians and the rest of those that are seen are read, records written, and `per_record` bytes of
  /// lists a record, `per_pair` a pair.
  [[nodiscard]] Floor project(const char* name, double per_record, double per_pair) const {
    const double rest = kFloat * (channels_ - kMean) + constants();
    return {name,
            kFloat * kMean * c_.gaussians + rest * c_.listed_gaussians + (record() + per_record) * c_.listed_records +
                per_pair * c_.pairs,
            kPlace * c_.gaussians * c_.views + seen_operations()};
  }
  [[nodiscard]] Floor sort(const char* name, double items, double bytes) const { return {name, bytes * items, 0}; }
  /// Records' places and shapes in depth order become the tiles' lists.
  [[nodiscard]] Floor bin(const char* name) const {
    return {name, (kKey + 6 * kFloat) * c_.listed_records + kEntry * c_.pairs, 0};
  }
  [[nodiscard]] Floor blend(const char* name) const {
    return {name, record() * c_.blended_records + kEntry * c_.blended_pairs + kFloat * (planes() + 1) * c_.pixels,
            (alpha() + kComposite + planes()) * c_.evaluations};
  }
  [[nodiscard]] Floor loss(const char* name) const {
    const double curve = transfer_ ? kCurve + kCurveExponentials * costs_.exponential : 0;
    // Three floats read, four bytes of the target, three floats of gradient.
    return {name, (2 * kFloat + 4.0 / 3) * planes() * c_.pixels, (kLoss + curve) * planes() * c_.pixels};
  }
  [[nodiscard]] Floor blend_backward(const char* name) const {
    const double sums = costs_.sums ? kMoments + planes() : 0;
    return {name,
            (record() + sums_of_record()) * c_.blended_records + kEntry * c_.blended_pairs +
                kFloat * (planes() + 1) * c_.pixels,
            (alpha() + kComposite + planes() + kAlphaGradient + sums) * c_.evaluations};
  }
  /// Gradients of the parameters go to memory, added to what was there.
  [[nodiscard]] Floor gradients(const char* name) const {
    return {name,
            sums_of_record() * c_.blended_records +
                (kFloat * (channels_ + 2 * active_) + constants()) * c_.blended_gaussians,
            gradient_operations()};
  }
  [[nodiscard]] Floor adam(const char* name) const {
    return {name, (kFloat * 7 * active_ + 2 * kFloat) * c_.blended_gaussians, kAdam * active_ * c_.blended_gaussians};
  }
  /// Gradients and Adam: parameters and moments are read and written once.
  [[nodiscard]] Floor update(const char* name) const {
    const double untrained = kFloat * (channels_ - active_);
    return {name,
            sums_of_record() * c_.blended_records +
                (kFloat * 6 * active_ + untrained + constants() + 2 * kFloat) * c_.blended_gaussians,
            gradient_operations() + kAdam * active_ * c_.blended_gaussians};
  }
  /// A mark and two figures a Gaussian, and the gradient's channels where it lies in memory.
  [[nodiscard]] Floor clear(const char* name, bool values) const {
    return {name, (1 + 2 * kFloat + (values ? kFloat * active_ : 0)) * c_.gaussians, 0};
  }

 private:
  [[nodiscard]] int planes() const { return albedo_ ? 6 : 3; }
  /// Place, log of alpha, conic factor, colours.
  [[nodiscard]] double record() const { return kFloat * (6 + planes()); }
  /// Six moments, colours.
  [[nodiscard]] double sums_of_record() const { return kFloat * (6 + planes()); }
  /// Normal and visibility.
  [[nodiscard]] double constants() const { return transfer_ ? 4 * kFloat : 0; }
  [[nodiscard]] double alpha() const { return kAlpha + kAlphaExponentials * costs_.exponential; }
  /// Of the SH basis at a direction.
  [[nodiscard]] double basis() const {
    constexpr double kOfDegree[4] = {0, 3, 17, 37};
    const int degree = coefficients_ == 1 ? 0 : (coefficients_ == 4 ? 1 : (coefficients_ == 9 ? 2 : 3));
    return kOfDegree[degree];
  }
  /// The light that a Gaussian's normal sees: bands (27), cosine and sun (7); with the residual's (27).
  [[nodiscard]] double light() const { return basis() + 34 + 27; }
  [[nodiscard]] double shade() const {
    if (transfer_) return light() + 3 + 27 + 3;
    const double direction = coefficients_ > 1 ? 10 : 0;
    return direction + basis() + 3 * coefficients_ + 3;
  }
  [[nodiscard]] double shade_backward() const {
    if (transfer_) return light() + 3 + 27;
    // Every coefficient's gradient; and, but for constants, the direction's through the basis.
    const double own = 3 * coefficients_;
    return coefficients_ > 1 ? 10 + 2 * basis() + 2 * own + 9 : own;
  }
  [[nodiscard]] double seen_operations() const {
    return (kShape + kShapeExponentials * costs_.exponential) * c_.listed_gaussians +
           (kProject + kProjectExponentials * costs_.exponential + shade()) * c_.listed_records;
  }
  /// The projection is worked out again, and going back through it takes at least as much.
  [[nodiscard]] double gradient_operations() const {
    return (2 * kShape + kShapeExponentials * costs_.exponential) * c_.blended_gaussians +
           (2 * (kPlace + kProject) + shade_backward()) * c_.blended_records;
  }

  const Census& c_;
  Costs costs_;
  bool transfer_, albedo_;
  int channels_, active_, coefficients_;
};

}  // namespace

std::vector<Floor> cuda_floors(const Job& job) {
  const Model m(job, kCuda);
  return {m.project("project_and_list", 0, kKey + kEntry),
          m.sort("sort", job.census.pairs, kKey + 2 * kEntry),
          m.blend("blend_forward"),
          m.loss("loss"),
          m.blend_backward("blend_backward"),
          m.update("update")};
}

std::vector<Floor> cpu_floors(const Job& job) {
  const Model m(job, kCpu);
  return {m.clear("clear", !job.fused),
          m.project("project", kKey, 0),
          m.sort("sort", job.census.listed_records, 2 * kKey),
          m.bin("bin"),
          m.blend("blend"),
          m.loss("loss"),
          m.blend_backward("blend_backward"),
          m.update("project_backward_adam"),
          m.gradients("project_backward"),
          m.adam("adam")};
}

nlohmann::json roofline(const std::vector<Floor>& floors, const Peaks& peaks, const nlohmann::json& measured) {
  nlohmann::json lines = nlohmann::json::object();
  for (const Floor& floor : floors) {
    if (!measured.contains(floor.stage)) continue;
    const double memory_ms = 1e3 * floor.bytes / peaks.bytes_per_s;
    const double compute_ms = 1e3 * floor.operations / peaks.operations_per_s;
    const double floor_ms = std::max(memory_ms, compute_ms), measured_ms = measured.at(floor.stage);
    lines[floor.stage] = {{"bytes", floor.bytes},
                          {"operations", floor.operations},
                          {"floor_ms", floor_ms},
                          {"measured_ms", measured_ms},
                          {"times_floor", floor_ms > 0 ? measured_ms / floor_ms : 0},
                          {"bound", memory_ms >= compute_ms ? "memory" : "compute"}};
  }
  return lines;
}

void add_roofline(const std::vector<Floor>& floors, const Peaks& peaks, const Census& c, nlohmann::json& result) {
  result["machine"] = {{"bytes_per_s", peaks.bytes_per_s}, {"operations_per_s", peaks.operations_per_s}};
  result["work"] = {{"gaussians", c.gaussians},
                    {"views", c.views},
                    {"pixels", c.pixels},
                    {"listed_records", c.listed_records},
                    {"listed_gaussians", c.listed_gaussians},
                    {"pairs", c.pairs},
                    {"evaluations", c.evaluations},
                    {"blended_records", c.blended_records},
                    {"blended_gaussians", c.blended_gaussians},
                    {"blended_pairs", c.blended_pairs}};
  result["roofline"] = roofline(floors, peaks, result.at("stages"));
}

std::string roofline_table(const nlohmann::json& result) {
  const auto& machine = result.at("machine");
  std::string text =
      fmt::format("machine: {:.0f} GB/s, {:.0f} G multiply-adds/s\n{:<22} {:>9} {:>9} {:>9} {:>9} {:>7}  bound\n",
                  machine.at("bytes_per_s").get<double>() * 1e-9, machine.at("operations_per_s").get<double>() * 1e-9,
                  "stage", "MB", "M ops", "floor ms", "ms", "times");
  for (const auto& [stage, milliseconds] : result.at("stages").items()) {
    if (!result.at("roofline").contains(stage)) {
      text += fmt::format("{:<22} {:>9} {:>9} {:>9} {:>9.3f} {:>7}  no floor is known\n", stage, "-", "-", "-",
                          milliseconds.get<double>(), "-");
      continue;
    }
    const auto& line = result.at("roofline").at(stage);
    text += fmt::format("{:<22} {:>9.2f} {:>9.1f} {:>9.4f} {:>9.3f} {:>7.1f}  {}\n", stage,
                        line.at("bytes").get<double>() * 1e-6, line.at("operations").get<double>() * 1e-6,
                        line.at("floor_ms").get<double>(), line.at("measured_ms").get<double>(),
                        line.at("times_floor").get<double>(), line.at("bound").get<std::string>());
  }
  return text;
}

}  // namespace splatbus::bench
