//! The `facile` program; see `facile --help`.

mod cli;

fn main() -> std::process::ExitCode {
    cli::main()
}
