#include "bezier_fem/meshed_surface.h"

#include <fcntl.h>
#include <poll.h>
#include <pwd.h>
#include <spawn.h>
#include <sys/file.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <vector>

#include "bezier_fem/error.h"

extern char** environ;

namespace bezier_fem
{
namespace
{
namespace fs = std::filesystem;
using Log = std::function<void(const std::string&)>;

/** Part of every key: to be raised when make_model makes other meshes of the same input. */
constexpr const char* CACHE_VERSION = "1";

class FileDescriptor
{
public:
  explicit FileDescriptor(int fd = -1) : fd_(fd) {}
  FileDescriptor(const FileDescriptor&) = delete;
  FileDescriptor& operator=(const FileDescriptor&) = delete;
  ~FileDescriptor() { reset(); }
  int get() const { return fd_; }
  void reset(int fd = -1)
  {
    if (fd_ >= 0) close(fd_);
    fd_ = fd;
  }

private:
  int fd_;
};

/** Exact, and the same on every machine. */
std::string printed(double value)
{
  std::array<char, 32> digits;
  std::snprintf(digits.data(), digits.size(), "%.17g", value);
  return digits.data();
}

std::string cacheKey(const std::string& surface, double cell_size, double scale, const std::vector<SizePoint>& sizing)
{
  std::uint64_t hash = 0xCBF29CE484222325;  // FNV-1a
  const auto add = [&](const char* bytes, std::size_t count) {
    for (std::size_t i = 0; i < count; ++i) hash = (hash ^ static_cast<unsigned char>(bytes[i])) * 0x100000001B3;
  };
  std::error_code error;
  if (!fs::exists(surface, error)) throw InputError(surface + ": there is no such file");
  if (!fs::is_regular_file(surface, error)) throw InputError(surface + ": is not a file");
  std::ifstream file(surface, std::ios::binary);
  std::vector<char> buffer(1 << 16);
  std::uint64_t size = 0;
  do
  {
    file.read(buffer.data(), static_cast<std::streamsize>(buffer.size()));
    size += static_cast<std::uint64_t>(file.gcount());
    add(buffer.data(), static_cast<std::size_t>(file.gcount()));
  } while (file);
  if (!file.eof()) throw InputError(surface + ": cannot be read");

  const fs::path path(surface);
  std::string rest = "|" + std::to_string(size) + path.extension().string() + "|" + printed(cell_size) + "|" +
                     printed(scale) + "|" + CACHE_VERSION;
  for (const auto& [p, wanted] : sizing)
    rest += "|" + printed(p.x()) + "," + printed(p.y()) + "," + printed(p.z()) + "," + printed(wanted);
  add(rest.data(), rest.size());
  std::array<char, 17> digits;
  std::snprintf(digits.data(), digits.size(), "%016llx", static_cast<unsigned long long>(hash));
  return path.stem().string() + "-" + digits.data();
}

fs::path cacheDirectory()
{
  // By the XDG base directory specification a relative path counts as unset.
  const char* xdg = std::getenv("XDG_CACHE_HOME");
  if (xdg && xdg[0] == '/') return fs::path(xdg) / "bezier_fem";
  const char* home = std::getenv("HOME");
  if (!home || !*home)
    if (const passwd* user = getpwuid(getuid())) home = user->pw_dir;
  if (!home || !*home) throw InputError("neither XDG_CACHE_HOME nor HOME is set: no place to keep meshes of surfaces");
  return fs::path(home) / ".cache" / "bezier_fem";
}

/** Whether a file of the cache is whole; what a full disk or another program left there is made again. */
bool isWhole(const fs::path& path)
{
  static const std::string END = "$EndElements\n";
  std::ifstream file(path, std::ios::binary | std::ios::ate);
  if (!file || file.tellg() < static_cast<std::streamoff>(END.size())) return false;
  file.seekg(-static_cast<std::streamoff>(END.size()), std::ios::end);
  std::string tail(END.size(), '\0');
  return file.read(tail.data(), static_cast<std::streamsize>(tail.size())) && tail == END;
}

/** Hands on the lines of a stream as they become complete. */
class LineSplitter
{
public:
  explicit LineSplitter(Log take) : take_(std::move(take)) {}
  void add(const char* bytes, std::size_t count)
  {
    for (std::size_t i = 0; i < count; ++i)
    {
      if (bytes[i] == '\n')
        finish();
      else
        line_ += bytes[i];
    }
  }
  void finish()
  {
    if (!line_.empty()) take_(line_);
    line_.clear();
  }

private:
  Log take_;
  std::string line_;
};

struct Finished
{
  int status;                       // as waitpid() gives it
  std::vector<std::string> errors;  // the lines of stderr
};

/** Runs a program without a shell; its stdout goes to `log` line by line. */
Finished runProgram(const std::string& program, std::vector<std::string> arguments, const Log& log)
{
  const auto fail = [&](int error) { throw InputError(program + " cannot be started: " + std::strerror(error)); };
  std::array<FileDescriptor, 2> ours, theirs;  // of stdout and stderr
  for (int i = 0; i < 2; ++i)
  {
    int ends[2];
    if (pipe2(ends, O_CLOEXEC) != 0) fail(errno);
    ours[i].reset(ends[0]);
    theirs[i].reset(ends[1]);
  }
  std::vector<char*> argv;
  argv.reserve(arguments.size() + 2);
  arguments.insert(arguments.begin(), program);
  for (std::string& argument : arguments) argv.push_back(argument.data());
  argv.push_back(nullptr);

  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addopen(&actions, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
  posix_spawn_file_actions_adddup2(&actions, theirs[0].get(), STDOUT_FILENO);
  posix_spawn_file_actions_adddup2(&actions, theirs[1].get(), STDERR_FILENO);
  pid_t child = 0;
  const int error = posix_spawn(&child, program.c_str(), &actions, nullptr, argv.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  if (error != 0) fail(error);
  for (FileDescriptor& end : theirs) end.reset();

  Finished finished{0, {}};
  std::array<LineSplitter, 2> lines{LineSplitter([&](const std::string& line) {
                                      if (log) log(line);
                                    }),
                                    LineSplitter([&](const std::string& line) { finished.errors.push_back(line); })};
  while (ours[0].get() >= 0 || ours[1].get() >= 0)
  {
    std::array<pollfd, 2> waiting{pollfd{ours[0].get(), POLLIN, 0}, pollfd{ours[1].get(), POLLIN, 0}};
    if (poll(waiting.data(), waiting.size(), -1) < 0) continue;  // interrupted
    for (int i = 0; i < 2; ++i)
    {
      if (waiting[i].revents == 0) continue;
      std::array<char, 4096> buffer;
      const ssize_t count = read(ours[i].get(), buffer.data(), buffer.size());
      if (count > 0) lines[i].add(buffer.data(), static_cast<std::size_t>(count));
      if (count == 0 || (count < 0 && errno != EINTR)) ours[i].reset();
    }
  }
  for (LineSplitter& splitter : lines) splitter.finish();
  while (waitpid(child, &finished.status, 0) < 0)
    if (errno != EINTR) fail(errno);
  return finished;
}

std::string makeModelProgram()
{
  std::error_code error;
  const fs::path self = fs::read_symlink("/proc/self/exe", error);
  const fs::path program = self.parent_path() / "make_model";
  if (error || access(program.c_str(), X_OK) != 0)
    throw InputError("surfaces are meshed by make_model, and there is none at " + program.string());
  return program.string();
}

/** @param sizing  a file; none where empty */
void makeModel(const std::string& surface, const fs::path& output, double cell_size, double scale,
               const std::string& sizing, const Log& log)
{
  const std::string program = makeModelProgram();
  if (log) log("meshing " + surface + " with cell size " + printed(cell_size) + " m");
  std::vector<std::string> arguments{"--cell-size=" + printed(cell_size), "--scale=" + printed(scale)};
  if (!sizing.empty()) arguments.push_back("--sizing=" + sizing);
  arguments.insert(arguments.end(), {"--", surface, output.string()});
  const Finished run = runProgram(program, std::move(arguments), log);
  if (WIFSIGNALED(run.status))
    throw InputError(surface + ": make_model was killed by signal " + std::to_string(WTERMSIG(run.status)) + " (" +
                     strsignal(WTERMSIG(run.status)) + "); cell size " + printed(cell_size) +
                     " m may need too much memory");
  if (WEXITSTATUS(run.status) != 0)
    throw InputError(run.errors.empty()
                         ? surface + ": make_model failed with status " + std::to_string(WEXITSTATUS(run.status))
                         : run.errors.back());
  if (log)
    for (const std::string& warning : run.errors) log(warning);
}

}  // namespace

std::string meshedSurface(const std::string& surface, double cell_size, double scale,
                          const std::vector<SizePoint>& sizing, const Log& log)
{
  const std::string key = cacheKey(surface, cell_size, scale, sizing);
  const fs::path directory = cacheDirectory();
  const fs::path cached = directory / (key + ".msh");
  if (isWhole(cached)) return cached.string();

  std::error_code error;
  fs::create_directories(directory, error);
  // The first to come makes the mesh, the others wait for it. The lock goes with the process, however that ends.
  const FileDescriptor lock(open((directory / (key + ".lock")).c_str(), O_CREAT | O_RDWR | O_CLOEXEC, 0666));
  if (lock.get() < 0)
    throw InputError("meshes of surfaces cannot be kept in " + directory.string() + " (" + std::strerror(errno) +
                     "); XDG_CACHE_HOME may name another place");
  while (flock(lock.get(), LOCK_EX) != 0)
    if (errno != EINTR) throw InputError(directory.string() + ": cannot be locked: " + std::strerror(errno));
  if (isWhole(cached)) return cached.string();

  const std::string ours = key + "." + std::to_string(getpid());
  const fs::path fresh = directory / (ours + ".msh"), sizing_file = directory / (ours + ".csv");
  const auto clear = [&] {
    fs::remove(fresh, error);
    fs::remove(sizing_file, error);
  };
  try
  {
    if (!sizing.empty()) writeSizing(sizing_file.string(), sizing);
    makeModel(surface, fresh, cell_size, scale, sizing.empty() ? "" : sizing_file.string(), log);
    if (cacheKey(surface, cell_size, scale, sizing) != key)
      throw InputError(surface + ": has changed while it was meshed");
    fs::rename(fresh, cached, error);
    if (error) throw InputError(cached.string() + ": cannot be written: " + error.message());
  }
  catch (...)
  {
    clear();
    throw;
  }
  clear();
  return cached.string();
}

}  // namespace bezier_fem
