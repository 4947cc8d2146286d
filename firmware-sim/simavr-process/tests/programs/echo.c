/* Sends every byte back from the interrupt, and sleeps. */
#include "uart.h"

ISR(USART_RX_vect)
{
	UDR0 = UDR0;
}

int main(void)
{
	uart_begin();
	UCSR0B |= 1 << RXCIE0;
	sleep_enable();
	sei();
	for (;;)
		sleep_cpu();
}
