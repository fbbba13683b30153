#include <gmock/gmock.h>
#include <sys/stat.h>

#include <fstream>
#include <utility>

#include "../bus/bus_fixture.h"
#include "bus/error.h"
#include "bus/keys.h"
#include "run_verb.h"

namespace splatbus::cli {
namespace {

using testing::HasSubstr;

class KeysVerb : public testing::Test {
 protected:
  std::string run(std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), {"keys", "--folder", folder_});
    return run_verb(add_keys_verb, std::move(arguments));
  }
  [[nodiscard]] bus::Rights rights_of(const bus::Key& key) const {
    return bus::AllowList(folder_ + "/allowed").rights_of(key);
  }

  bus_test::TemporaryDirectory directory_;
  std::string folder_ = directory_.path() + "/keys";
};

TEST_F(KeysVerb, NewMakesAFileThatItsOwnerAloneCanRead) {
  EXPECT_THAT(run({"new", "server"}), HasSubstr("public key: "));
  struct stat status {};
  ASSERT_EQ(::stat((folder_ + "/server.key").c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 0777U, 0600U);
  ASSERT_EQ(::stat(folder_.c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 0777U, 0700U);
  const auto keys = bus::read_key_file(folder_ + "/server.key");
  EXPECT_EQ(rights_of(keys.public_key), bus::Rights());
  EXPECT_THROW(run({"new", "server"}), bus::Error) << "the first one would be lost";
  EXPECT_EQ(bus::read_key_file(folder_ + "/server.key").public_key, keys.public_key);
}

TEST_F(KeysVerb, RolesAllowAndRevokeShutsOut) {
  run({"new", "laptop", "--role", "view", "--role", "probe"});
  const auto laptop = bus::read_key_file(folder_ + "/laptop.key").public_key;
  EXPECT_EQ(rights_of(laptop), (bus::Rights{.view = true, .probe = true}));
  const auto other = bus::make_key_pair().public_key;
  run({"allow", other, "--name", "other", "--role", "control"});
  EXPECT_EQ(rights_of(other), (bus::Rights{.control = true}));
  run({"allow", other, "--name", "other", "--role", "view"});
  EXPECT_EQ(rights_of(other), (bus::Rights{.view = true})) << "the last word holds";
  EXPECT_THAT(run({"list"}), testing::AllOf(HasSubstr(laptop + " view,probe"), HasSubstr(other + " view"),
                                            HasSubstr("own     laptop")));
  EXPECT_THAT(run({"revoke", "laptop"}), HasSubstr("laptop"));
  EXPECT_EQ(rights_of(laptop), bus::Rights());
  EXPECT_EQ(rights_of(other), (bus::Rights{.view = true}));
  EXPECT_THROW(run({"revoke", "laptop"}), std::runtime_error);
}

TEST_F(KeysVerb, NonsenseIsRefused) {
  EXPECT_THROW(run({"allow", "1234", "--role", "view"}), bus::Error);
  EXPECT_THROW(run({"allow", bus::make_key_pair().public_key}), CLI::ParseError) << "a key that may nothing";
  EXPECT_THROW(run({"new", "a", "--role", "admin"}), CLI::ParseError);
  EXPECT_THROW(run({"new", "../a"}), std::runtime_error);
  EXPECT_THROW(run({"new", "two words", "--role", "view"}), bus::Error);
}

TEST_F(KeysVerb, FilesThatOthersCouldChangeAreNotBelieved) {
  run({"new", "server"});
  ASSERT_EQ(::chmod((folder_ + "/server.key").c_str(), 0640), 0);
  EXPECT_THROW(bus::read_key_file(folder_ + "/server.key"), bus::Error);
  std::ofstream(folder_ + "/half.key") << "public = 12\n";
  ASSERT_EQ(::chmod((folder_ + "/half.key").c_str(), 0600), 0);
  EXPECT_THROW(bus::read_key_file(folder_ + "/half.key"), bus::Error);
  const auto one = bus::make_key_pair(), two = bus::make_key_pair();
  bus::write_key_file(folder_ + "/mixed.key", {one.public_key, two.secret_key});
  EXPECT_THROW(bus::read_key_file(folder_ + "/mixed.key"), bus::Error);
  run({"new", "laptop", "--role", "view"});
  const auto laptop = bus::read_key_file(folder_ + "/laptop.key").public_key;
  std::ofstream(folder_ + "/allowed", std::ios::app) << "a line without sense\n";
  EXPECT_EQ(rights_of(laptop), bus::Rights()) << "one bad line, and nobody is let in";
}

}  // namespace
}  // namespace splatbus::cli
