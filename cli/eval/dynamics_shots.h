#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <map>
#include <opencv2/core.hpp>
#include <optional>
#include <set>
#include <utility>
#include <vector>

#include "dynamics_figures.h"
#include "metrics/metrics.h"
#include "probe_round.h"
#include "scene_view.h"

namespace splatbus::cli {

/// A figure over parts of a picture; nullopt where there is no such part.
struct MaskedFigures {
  std::optional<double> moving;  ///< objects that can move, and 5 pixels around them
  std::optional<double> shadow;  ///< within 10 pixels of a shadow's edge that has moved since the camera's last picture
};

/// Figures of a drawn picture against the engine's.
struct DrawnFigures {
  metrics::Quality whole;
  MaskedFigures masked, masked_psnr, masked_flip;  ///< SSIM, and the others
  std::map<std::uint32_t, double> object_ssim;     ///< of objects that can move and show
  /// FLIP where an object was seen that vanished 2 to 4 s ago and nothing that can move is now.
  std::optional<double> ghost_flip;
  std::optional<double> settled_flip;  ///< the same 15 to 25 s after it: what is left is no ghost
};

/// A held-out camera at one instant.
struct DynamicsSample {
  double time_s = 0;  ///< of the engine
  std::size_t camera = 0;
  std::uint64_t probe_id = 0;
  bool paired = false;              ///< drawn with visibility of its own scene version
  bool extra = false;               ///< of a round of one camera alone, for motion: it is not judged
  std::set<std::uint32_t> objects;  ///< that can move and are there
  std::optional<DrawnFigures> on, off;
  std::optional<DrawnFigures> viewer;      ///< of the viewer's own picture
  MaskedFigures still;                     ///< the still scene's at the same pixels
  std::optional<double> still_ghost_flip;  ///< likewise
};

/// Mean SSIM and FLIP of every pixel of a camera's pictures, CV_32FC1.
struct CameraMaps {
  cv::Mat ssim, flip;
};
using MapsOfCameras = std::map<std::size_t, CameraMaps>;

[[nodiscard]] std::set<std::uint32_t> ids_of(const ObjectTransforms& objects);

/// Where objects were that have vanished, by camera.
class GhostMasks {
 public:
  /// Ghosts are judged at these ages.
  GhostMasks(double from_s, double to_s) : from_s_(from_s), to_s_(to_s) {}

  /// The mask of a picture's ghosts, those that are so old; empty where there are none. Pictures of a camera come
  /// by ascending time.
  [[nodiscard]] cv::Mat take(std::size_t camera, double time_s, const ObjectTransforms& objects,
                             const cv::Mat& object_id);

 private:
  struct Ghost {
    cv::Mat mask;
    double since_s = 0;
  };
  struct Seen {
    cv::Mat object_id;
    ObjectTransforms objects;
    std::map<std::uint32_t, Ghost> ghosts;
  };
  double from_s_, to_s_;
  std::map<std::size_t, Seen> cameras_;
};

/// Drawn pictures that wait to be compared with the engine's: comparing takes longer than drawing.
class DynamicsShots {
 public:
  /// `still`: where it is given, the still scene's maps, for the same pixels' figures. `viewer`: the folder to which
  /// the viewer writes its pictures of probes.
  DynamicsShots(const TimeWindow& window, const MapsOfCameras* still, std::filesystem::path viewer)
      : window_(window), still_(still), viewer_(std::move(viewer)) {}

  struct Drawn {
    cv::Mat engine, on, off;  ///< CV_8UC3 BGR; empty when it was not drawn
  };
  /// Of sample `sample`. `lights` are those of the same instant; may be null.
  void add(std::size_t sample, std::size_t camera, const ProbePicture& probe, const SceneLights* lights,
           const Drawn& drawn);

  /// Fills in the figures of the samples whose pictures wait, but for the newest `kept`: the viewer may not have drawn
  /// those yet.
  void compare(std::vector<DynamicsSample>& samples, std::size_t kept);
  /// The viewer's picture of a probe, CV_8UC3 BGR; empty where it has not written one.
  [[nodiscard]] cv::Mat viewer_picture(std::uint64_t probe_id) const;
  [[nodiscard]] std::size_t waiting() const { return shots_.size(); }
  /// Of the pictures drawn "on" within the window.
  [[nodiscard]] MapsOfCameras mean_maps() const;

 private:
  struct Shot {
    std::size_t sample = 0;
    Drawn drawn;
    cv::Mat moving, shadow, ghost, settled;  ///< masks; empty where they could not be had
    std::map<std::uint32_t, cv::Mat> objects;
  };
  /// Masks of a camera's last picture: where something moves, and what the sun lights.
  struct Before {
    cv::Mat moving, lit;
  };
  struct Maps {
    MeanMap ssim, flip;
  };

  void make_masks(std::size_t camera, const ProbePicture& probe, const SceneLights* lights, Shot& shot);
  [[nodiscard]] static MaskedFigures masked_figures(const cv::Mat& map, const Shot& shot);
  [[nodiscard]] std::optional<DrawnFigures> figures(const Shot& shot, const cv::Mat& drawn,
                                                    const DynamicsSample& sample, bool is_on);

  TimeWindow window_;
  const MapsOfCameras* still_;
  std::filesystem::path viewer_;
  GhostMasks ghosts_{2, 4}, settled_{15, 25};
  std::map<std::size_t, Before> before_;  ///< by camera
  std::vector<Shot> shots_;
  std::map<std::size_t, Maps> maps_;
};

}  // namespace splatbus::cli
