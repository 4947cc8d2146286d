; A second interrupt of 32 cycles, a critical section of 10, a section of 7 marked
; with a 3, and 20 bytes of stack.
#define __SFR_OFFSET 0
#include <avr/io.h>

	.global main
	.global TIMER0_COMPA_vect

; 4 cycles to respond, 3 for the jump, 1 + 20 here, 4 to return.
TIMER0_COMPA_vect:
	nop
	.rept 10
	rjmp .
	.endr
	reti

main:
	; 2 bytes of return address are on the stack.
	.rept 16
	push r1
	.endr
	ldi r16, 1 << WGM01
	out TCCR0A, r16
	ldi r16, 249
	out OCR0A, r16
	ldi r16, 1 << OCIE0A
	sts TIMSK0, r16
	ldi r16, 1 << CS01 | 1 << CS00
	out TCCR0B, r16
	ldi r16, 1 << SE
	out SMCR, r16
	clr r17
	ldi r18, 3
	sei
loop:
	sleep
	; From the end of one OUT to the end of the next.
	out GPIOR0, r18
	.rept 6
	nop
	.endr
	out GPIOR0, r17
	; From the end of CLI to the end of SEI.
	cli
	.rept 9
	nop
	.endr
	sei
	rjmp loop
