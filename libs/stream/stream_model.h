#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <span>
#include <unordered_map>
#include <unordered_set>
#include <vector>

#include "gaussians/camera.h"
#include "stream/delta_selection.h"
#include "stream/model_quantizer.h"
#include "stream/page_codec.h"
#include "stream/page_precision.h"
#include "stream/replicated_state.h"
#include "stream/stream_handover.h"
#include "stream/stream_update.h"

namespace splatbus::stream {

struct StreamOptions {
  std::size_t max_gaussians = kMaxGaussians;  ///< that are offered; of a larger model a part is
  Schedules schedules = default_schedules();
  std::uint32_t calm_ticks = 8;
  PageCodec codec = PageCodec::Planes;
  float coarseness = Precision::kLossless;  ///< of what is held, as Precision has it
};

/// The streamer's side: the pages that viewers may have, as integers, and the packets that follow the published model.
/// What anybody holds changes only by the very bytes that are sent; what nobody holds, without any. What rests costs
/// nothing but its place: pages that were frozen all the time are not read again, and pages of which nothing has
/// changed for long are in no tick's way.
///
/// One thread, or two: while one of them observes, ticks or resets, the other may call take_scene(), take_update(),
/// page_packets(), page_visibility(), manifest_packets(), gone_packet(), scene_packet(), scene_version(),
/// layout_packet(), offered() and status(), which wait for one packet at most (a reset for longer), and nothing else.
/// What is done for each Gaussian is shared among TBB's workers.
class StreamModel {
 public:
  /// `device`: in whose memory the views lie that observe() is given.
  StreamModel(PacketWriter writer, std::uint64_t stream_epoch, const StreamOptions& options = {},
              Device device = Device::Cpu);

  /// Quantizes what is published now into memory of its own; `still_valid` says afterwards whether what was read was
  /// whole. False when it was not: everything is as before. After a view of another layout (appearance, degree) ready()
  /// is false. A view without pages is cut into some.
  bool observe(const GaussiansView& gaussians, const std::function<bool()>& still_valid = {});
  void set_schedules(const Schedules& schedules);

  /// What was observed becomes what is offered, in a new epoch: pages of the one before are nothing any more.
  void reset_to_target();
  /// Nobody holds anything any more: the next reset_to_target() may choose other quantizers.
  void release() { set_ready(false); }
  /// The same, but what the next reset_to_target() begins is that stream, where the model is of its layout.
  void join(const StreamOrigin& origin);
  /// Before anything is observed: goes on with what another streamer has handed over. Pages are offered as it had them,
  /// and the next tick brings what has changed since.
  void resume(StreamHandover handover);
  /// For the streamer that comes next: what read_handover() reads. Asserts ready().
  [[nodiscard]] Bytes hand_over();
  /// Pages that change from now on have larger versions.
  void raise_version(std::uint32_t version);
  /// False before the first reset_to_target(), after release(), and when the observed layout is another one: only
  /// reset_to_target() helps.
  [[nodiscard]] bool ready() const { return ready_; }
  [[nodiscard]] bool observed() const { return target_layout_.has_value(); }

  /// Before a tick: the pages that anybody holds at some version and is to be sent deltas of. Before the first call:
  /// all.
  void set_holders(std::set<std::uint32_t> pages);
  /// Follows what was observed: pages that come and go, Gaussians that come and go, values. What viewers see most comes
  /// first, and new Gaussians of pages that are held, and values, stay near `budget_bytes`. Asserts ready(). Returns
  /// the packets' bytes. When it throws, ready() is then false.
  double make_tick(double budget_bytes, std::span<const Camera> viewers);
  /// Of all ticks since the last call.
  [[nodiscard]] StreamUpdate take_update();

  struct Status {
    bool ready = false;
    std::uint64_t epoch = 0, visibility_version = 0;
    std::uint32_t version = 0;  ///< of the newest page
    std::size_t gaussians = 0, pages = 0;
    ParameterLayout layout;
    float mean_step = 0;  ///< m, of the epoch's Layout
  };
  /// Of what is offered.
  [[nodiscard]] Status status() const;
  /// By number, as after the last tick; never null.
  [[nodiscard]] std::shared_ptr<const std::vector<OfferedPage>> offered() const;

  [[nodiscard]] EncodedPacket layout_packet() const;
  /// The page as it is now, in parts of `part_lanes` (a multiple of kBlockRows); nothing when it is no more. A
  /// version's blob is encoded once. `to_hold`: for somebody who holds it from now on, before set_holders() says so.
  [[nodiscard]] std::vector<PagePacket> page_packets(std::uint32_t page, std::uint32_t part_lanes = kPageLanes,
                                                     bool to_hold = true);
  /// Which pages there are: those of `pages`. Their bytes are those of the blob where it has been encoded. `gaussians`:
  /// in all pages, where others have some that are not in here.
  [[nodiscard]] std::vector<EncodedPacket> manifest_packets(std::span<const OfferedPage> pages,
                                                            std::span<const std::uint32_t> gone, bool whole,
                                                            std::optional<std::size_t> gaussians = {}) const;
  [[nodiscard]] EncodedPacket gone_packet(std::span<const std::uint32_t> pages) const;

  /// The packet that brings a newer scene to who holds the one before: none where its version is the one that is held,
  /// or nothing is offered. Throws StreamError, naming what is wrong, when its version is 0 or runs backwards, or the
  /// scene is none that travels (quantize_scene); all is then as before.
  [[nodiscard]] std::optional<EncodedPacket> take_scene(const SceneState& scene, const SceneInstant& instant);
  /// The scene that is held, against none; nothing while there is none.
  [[nodiscard]] std::optional<EncodedPacket> scene_packet() const;
  [[nodiscard]] std::uint64_t scene_version() const;

  /// What has changed of the lights' visibility, for who holds the pages: none when it is older than what is held, or
  /// nothing is offered. Light by light, what changes the pictures most first, until their bytes exceed `budget_bytes`;
  /// visibility_rests() says whether that was all, and a light that has waited comes sooner. Of a light that was sent
  /// what is held is within kMaxVisibilityError, and exact where it is 0 or 255. Throws StreamError when `visibility`
  /// is too short for the model that was observed last.
  [[nodiscard]] std::vector<VisibilityPacket> take_visibility(const LightsVisibility& visibility,
                                                              double budget_bytes = kNoBudget);
  [[nodiscard]] bool visibility_rests() const { return visibility_waits_.empty(); }
  /// All of one page's, for who has missed some.
  [[nodiscard]] std::vector<EncodedPacket> page_visibility(std::uint32_t page) const;
  static constexpr double kNoBudget = 1e300;
  static constexpr int kMaxVisibilityError = 6;

  [[nodiscard]] const ReplicatedState& held() const { return held_; }
  [[nodiscard]] std::size_t observed_count() const { return observed_count_; }
  /// By index of the model: what is in no page is 0.
  [[nodiscard]] const QuantizedGaussians& observed_gaussians() const { return target_; }
  /// Of all that was observed, Gaussians that the last observation has read.
  [[nodiscard]] std::size_t read_count() const { return read_.count(); }
  /// Pages that the last tick looked through for values to send.
  [[nodiscard]] std::size_t busy_pages() const { return busy_pages_; }
  [[nodiscard]] const ModelQuantizer& quantizer() const { return quantizer_; }
  /// Observed and not offered, after the last tick.
  [[nodiscard]] std::size_t unsent() const { return unsent_; }
  /// As many Gaussians are offered as may be, and the model has more.
  [[nodiscard]] bool full() const { return full_; }
  [[nodiscard]] std::size_t pending_deltas() const { return selection_.pending(); }

 private:
  static constexpr std::uint32_t kNoPage = 0xFFFFFFFFU;
  static constexpr std::size_t kPacketPages = 64;  ///< in one packet

  /// A page of the model that was observed.
  struct TargetPage {
    std::uint32_t page = 0, first = 0, count = 0;  ///< columns, which are the model's indices
    std::uint32_t object_id = 0;
    bool frozen = false;
    PageBounds bounds;
  };
  /// What is known of one, from its first observation on.
  struct KnownPage {
    IndexRange range;              ///< when it was read last; count 0: it never was, or is gone
    std::uint64_t generation = 0;  ///< then
    std::uint32_t usable = 0;      ///< Gaussians
    bool settled = false;          ///< since its Gaussians last changed, what is held was found to have the same
    bool followed = false;         ///< since anything of it last changed, what is held took its values: nobody holds it
    std::uint32_t idle_ticks = 0;  ///< since then, while somebody held it and nothing of it was worth sending
  };
  /// What becomes of it.
  struct PagePlan {
    const TargetPage* target = nullptr;
    std::uint32_t base = kNoPage;             ///< kNoPage: all of it is new
    std::vector<std::uint32_t> gone;          ///< lanes of the base
    std::vector<std::uint32_t> moved, fresh;  ///< columns that come from elsewhere; that are new
    bool left_out = false;                    ///< some of its columns are of Gaussians that another page has
    [[nodiscard]] bool changes() const {
      return base != target->page || !gone.empty() || !moved.empty() || !fresh.empty();
    }
  };
  /// Plans with one base, which change it in one packet: of at most kMaxPageGaussians that come to its pages.
  struct Family {
    std::vector<PagePlan*> plans;
    std::size_t moved = 0;
    /// False when there is no room for what moves.
    bool take(PagePlan& plan);
    /// What is new beyond the room comes with a later tick.
    void bound();
  };
  struct QuietPage {
    std::uint32_t ticks = 0;
    bool frozen = false;
  };
  struct Blob {
    std::uint32_t version = 0;
    std::map<std::pair<std::uint32_t, std::uint32_t>, std::shared_ptr<const Bytes>> parts;  ///< by first and count
  };
  struct LightChange {
    std::uint32_t light_id = 0;
    std::vector<std::uint32_t> rows;
    Bytes values;
    double weight = 0;  ///< in the pictures
  };

  static void append(Bytes& payload, std::span<const std::uint8_t> part) {
    payload.insert(payload.end(), part.begin(), part.end());
  }
  void set_ready(bool ready) {
    const std::scoped_lock lock(mutex_);
    ready_ = ready;
  }
  /// What of a view an observation reads.
  struct Reading {
    std::vector<IndexRange> ranges;
    std::vector<std::uint64_t> generations;  ///< of each
    std::vector<std::size_t> offsets;        ///< of each, its first column's
    std::vector<std::uint32_t> rows;         ///< of each column, range after range; kNotHeld: not held
    void place();
  };
  [[nodiscard]] Reading ranges_to_read(const GaussiansView& gaussians, bool all);
  void find_rows(Reading& reading, std::span<const std::uint64_t> ids) const;
  void take_observed(const Reading& reading);
  void take_range(const Reading& reading, std::size_t k);
  struct Difference {
    bool gaussians = false, values = false;
  };
  /// Takes columns `from`, from + 1, ... of read_ as columns first, first + 1, ..., and says what differed.
  Difference take_columns(std::uint32_t first, std::uint32_t count, std::size_t from);
  void vacate(const IndexRange& range);
  void cut_target(const GaussiansView& gaussians, std::span<const IndexRange> ranges);
  /// Of a page at that version, where it is encoded. Under the lock.
  [[nodiscard]] std::optional<std::size_t> blob_bytes(const OfferedPage& page) const;
  [[nodiscard]] const TargetPage* find_target(std::uint32_t page) const;
  [[nodiscard]] KnownPage& known(std::uint32_t page);
  [[nodiscard]] bool is_settled(std::uint32_t page) const { return page < known_.size() && known_[page].settled; }
  [[nodiscard]] bool is_idle(std::uint32_t page) const;
  [[nodiscard]] std::vector<std::uint32_t> busy_blocks();
  [[nodiscard]] std::vector<std::uint32_t> rows_of_other_objects(std::span<const std::uint32_t> blocks) const;
  [[nodiscard]] std::uint32_t row_of(std::uint64_t id) const;
  [[nodiscard]] std::uint32_t page_of_row(std::uint32_t row) const { return page_of_block_[row / kBlockRows]; }
  [[nodiscard]] std::uint32_t lane_of_row(std::uint32_t row) const {
    return block_index_[row / kBlockRows] * kBlockRows + row % kBlockRows;
  }
  void index_blocks();
  void map_columns();
  void map_page(const TargetPage& page);
  [[nodiscard]] std::vector<PagePlan> plan_pages();
  [[nodiscard]] PagePlan plan_page(const TargetPage& page, std::unordered_set<std::uint64_t>& fresh_ids) const;
  [[nodiscard]] std::uint32_t base_of(const TargetPage& page, const std::map<std::uint32_t, std::size_t>& shares) const;
  [[nodiscard]] bool anybody_holds(std::uint32_t page) const;
  [[nodiscard]] std::uint64_t place_of(std::uint32_t page) const;
  /// The target's columns as they are held: rounded.
  [[nodiscard]] QuantizedGaussians rounded(std::span<const std::uint32_t> columns) const;

  /// Makes the page what was observed of it; false, and all is as before, when none of its Gaussians can be held.
  bool fill_page(const TargetPage& page);
  void drop_page(std::uint32_t page);
  void tick_structure(double budget_bytes, std::span<const Camera> viewers, const ObjectTransforms& objects);
  void hold_back(std::vector<PagePlan>& plans, double budget_bytes, std::span<const Camera> viewers,
                 const ObjectTransforms& objects);
  void emit_structure(std::span<PagePlan> plans, std::span<const std::uint32_t> ended);
  void order_appended(std::span<PagePlan> plans) const;
  void tick_values(double budget_bytes, std::span<const Camera> viewers, const ObjectTransforms& objects);
  struct PageValues;
  void emit_values(std::span<const PageValues> pages);
  void take_appended(const PagePlan& plan, std::uint32_t left);
  Change emit(EncodedPacket packet, std::vector<DeltaPacket::Step> steps, std::vector<PageVersion> gone);
  void follow_unheld();
  void offer();
  /// Before anything is observed: where they are is known of what is held alone.
  void offer_held();

  [[nodiscard]] EncodedPacket write_scene(const QuantizedScene* base) const;
  void hold_scene();
  [[nodiscard]] LightChange change_of(std::uint32_t light_id, std::span<const std::uint8_t> of_index,
                                      const LightsVisibility& all) const;
  [[nodiscard]] VisibilityPacket write_visibility(const LightChange& light) const;

  PacketWriter writer_, brief_writer_ = PacketWriter::brief();
  StreamOptions options_;
  ModelQuantizer quantizer_;
  DeltaSelection selection_;
  Precision precision_;
  double tick_bytes_ = 0;  ///< of this tick's packets

  // What two threads touch. Who observes and ticks reads the Gaussians, their layout, ready_, version_ and
  // appended_bytes_ without it: nobody else writes them.
  mutable std::mutex mutex_;
  ReplicatedState held_;
  bool ready_ = false;
  QuantizedScene scene_;  ///< newest; held, where anything is
  SceneInstant instant_;
  StreamUpdate update_;         ///< that nobody has taken
  std::uint32_t version_ = 0;   ///< of the newest page
  double appended_bytes_ = 24;  ///< a Gaussian
  std::shared_ptr<const std::vector<OfferedPage>> offered_ = std::make_shared<std::vector<OfferedPage>>();
  std::uint64_t offered_epoch_ = 0;
  std::map<std::uint32_t, Blob> blobs_;
  std::optional<std::set<std::uint32_t>> holders_;
  std::set<std::uint32_t> asked_;  ///< pages that were sent since

  std::optional<std::set<std::uint32_t>> holders_now_;  ///< of both, when the tick began

  std::uint64_t own_epoch_;             ///< of the newest stream that was begun here
  std::optional<StreamOrigin> origin_;  ///< of the stream that the next reset joins
  std::optional<StreamLayout> target_layout_;
  QuantizedGaussians read_;  ///< by the last observation, range after range
  std::vector<std::uint8_t> read_usable_;
  QuantizedGaussians target_;
  std::vector<std::uint8_t> usable_;  ///< [columns]
  std::vector<TargetPage> target_pages_;
  std::vector<KnownPage> known_;           ///< by page
  std::uint32_t page_lanes_ = kPageLanes;  ///< of a page of the model
  std::size_t observed_count_ = 0, busy_pages_ = 0;
  std::vector<float> share_;                                    ///< [rows] of the pictures, of rows that are looked at
  std::vector<std::uint32_t> page_of_block_, block_index_;      ///< kNoPage: nobody's
  std::vector<std::uint32_t> row_of_column_;                    ///< kNotHeld: not held
  std::vector<std::uint32_t> column_of_row_;                    ///< kNotHeld: not in the target, or not usable
  std::vector<std::uint32_t> target_page_of_row_;               ///< kNoPage: in none
  std::unordered_map<std::uint64_t, std::uint32_t> row_of_id_;  ///< may name rows that hold another one by now
  std::map<std::uint32_t, QuietPage> quiet_;                    ///< by page
  std::uint32_t follow_next_ = 0;                               ///< page
  std::size_t unsent_ = 0;
  bool full_ = false;
  std::map<std::uint32_t, std::uint32_t> visibility_waits_;  ///< times that a light was left for later
};

}  // namespace splatbus::stream
