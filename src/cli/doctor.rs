use super::{output, terminal::Terminal};
use anyhow::{Result, bail};
use clap::Args;
use tid3r::doctor::{Part, Report, State, examine};
use tid3r_weights_convert::Places;

/// Say what this machine can do with tid3r, what will be slow and why, and how to mend it.
///
/// Looks at processor, threads, memory (limits of containers and batch jobs included), disks, GPU, weights, FFmpeg
/// and HEIC, and changes nothing. Each line says `ok`, `slow`, `missing` or `broken`, what was found, and what to do.
///
/// Exit code 0 if `reconstruct`, `segment` and `render` could run, and 1 if one of them could not. What they can do
/// without (FFmpeg, HEIC, See3D, MobileSAMv2, LPIPS) does not count.
#[derive(Debug, Args)]
pub(super) struct Doctor {
    /// Read all weights through, too, and compare their SHA-256: seconds for each gigabyte
    #[arg(long)]
    verify: bool,
    /// Print the report as JSON
    #[arg(long)]
    json: bool,
}

impl Doctor {
    pub(super) fn run(self, terminal: &Terminal) -> Result<()> {
        let report = examine(&Places::of_environment(), self.verify, terminal);
        match self.json {
            true => output::json(&report)?,
            false => print(&report)?,
        }
        let verbs = report
            .findings
            .iter()
            .filter(|finding| finding.part == Part::Verbs);
        let hindered = verbs.filter(|verb| matches!(verb.state, State::Missing | State::Broken));
        let hindered: Vec<_> = hindered.map(|verb| format!("`{}`", verb.name)).collect();
        if !hindered.is_empty() {
            bail!(
                "{} cannot run on this machine yet; see above what to do",
                hindered.join(" and ")
            );
        }
        Ok(())
    }
}

fn print(report: &Report) -> Result<()> {
    output::line(format!(
        "tid3r {}, built for {}",
        report.version, report.built_for
    ))?;
    let names = report.findings.iter().map(|finding| finding.name.len());
    let width = names.max().unwrap_or(0);
    let mut part = None;
    for finding in &report.findings {
        if part != Some(finding.part) {
            part = Some(finding.part);
            output::line(format!("\n{}", finding.part))?;
        }
        let fix = finding
            .fix
            .as_ref()
            .map_or_else(String::new, |fix| format!("; {fix}"));
        output::line(format!(
            "  {:<8} {:<width$}  {}{fix}",
            finding.state, finding.name, finding.text
        ))?;
    }
    Ok(())
}
